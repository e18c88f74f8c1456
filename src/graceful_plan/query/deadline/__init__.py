"""Calls that end in time: a clock, and motions that come quickly."""
