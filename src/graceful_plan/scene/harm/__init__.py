"""How bad damage is and how likely: tables of severity and fragility."""
