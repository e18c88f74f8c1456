"""Mobile bases: their kinematics and limits, and goals for them."""
