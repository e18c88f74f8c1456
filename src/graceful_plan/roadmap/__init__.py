"""Roadmaps: built once per scene, then used for many queries."""

from graceful_plan.roadmap.answers import FrontPath, QueryResult, QueryStatus
from graceful_plan.roadmap.roadmap import Roadmap

__all__ = ["FrontPath", "QueryResult", "QueryStatus", "Roadmap"]
