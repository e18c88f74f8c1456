"""Problems for the comparison of planners."""
