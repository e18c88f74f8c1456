"""Forms that a timed motion has outside of this library: JSON, CSV, Parquet, ROS messages."""
