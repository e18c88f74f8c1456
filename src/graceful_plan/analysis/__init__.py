"""Analyses of states and motions: clearance, risk, explanations, sensitivity and certificates."""
