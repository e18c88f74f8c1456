"""What all pictures share."""

PATH_COLOURS = ("#111111", "#0b62c4", "#00805a", "#a3408f")
"""Apart from each other and from the heat map for colour-blind eyes too; in print, the line styles tell them apart."""
