"""Mixture of the drop, spill and body models, weighted by a fault prior."""
