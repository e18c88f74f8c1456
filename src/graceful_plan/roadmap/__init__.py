"""Roadmaps that are built once per scene and asked again and again."""

from graceful_plan.roadmap.roadmap import FrontPath, Roadmap

__all__ = ["FrontPath", "Roadmap"]
