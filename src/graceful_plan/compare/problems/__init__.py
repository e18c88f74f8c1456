"""Problems that planners are compared on."""
