"""How bad it is: tables of severity and of fragility."""
