"""Composable costs: each runs in the core, has a gradient, and adds up with other costs and with the impact."""
