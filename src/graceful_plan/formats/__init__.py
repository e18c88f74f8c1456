"""Conversions of trajectories from and to JSON, CSV, Parquet and ROS messages."""
