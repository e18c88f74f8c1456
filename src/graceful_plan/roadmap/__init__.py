"""Roadmaps that are built once per scene and asked again and again."""

from graceful_plan.roadmap.answers import FrontPath, QueryResult, QueryStatus
from graceful_plan.roadmap.roadmap import Roadmap

__all__ = ["FrontPath", "QueryResult", "QueryStatus", "Roadmap"]
