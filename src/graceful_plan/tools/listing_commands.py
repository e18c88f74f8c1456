"""Commands that list scenes and planners, and the self-test: scenes, planners and doctor."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.tools.console import add_command, show
from graceful_plan.tools.parsing import DONE, FAILED


def add_to(commands: Any) -> None:
    """Add the commands of this module to the parser."""
    add_command(commands, "scenes", _scenes, "list the bundled scenes and their tasks")
    add_command(commands, "planners", _planners, "list the planners and their settings")
    add_command(commands, "doctor", _doctor, "versions, instruction set in use, self-test")


def _scenes(args: argparse.Namespace) -> int:
    scenes = {name: gp.load_scene(name) for name in (*gp.scenes(), *gp.mobile_scenes())}
    document = {
        name: {
            "joints": list(scene.joints),
            "keyframes": sorted(scene.keyframes),
            "entities": {entity.name: entity.category for entity in scene.entities.values()},
            "tasks": {task.name: task.description for task in scene.tasks.values()},
        }
        for name, scene in scenes.items()
    }
    lines = []
    for name, scene in scenes.items():
        lines += [f"{name}: {len(scene.entities)} entities, {len(scene.joints)} joints"]
        lines += [f"  {task.name}: {task.description}" for task in scene.tasks.values()]
    show(args, document, "\n".join(lines))
    return DONE


def _planners(args: argparse.Namespace) -> int:
    document = {
        name: {
            "summary": (planner.__doc__ or "").strip().splitlines()[0],
            "anytime": planner.anytime,
            "settings": {field.name: repr(field.default) for field in _settings(planner)},
        }
        for name, planner in gp.PLANNERS.items()
    }
    rows = [[name, "yes" if entry["anytime"] else "no", entry["summary"]] for name, entry in document.items()]
    show(args, document, documents.table(["planner", "anytime", ""], rows))
    return DONE


def _settings(planner: Any) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(planner)


def _doctor(args: argparse.Namespace) -> int:
    from graceful_plan.tools import doctor

    findings = doctor.examine()
    document = {
        finding.name: {"ok": finding.ok, "value": finding.value, "detail": finding.detail} for finding in findings
    }
    rows = [["ok" if finding.ok else "FAILED", finding.name, finding.value, finding.detail] for finding in findings]
    show(args, document, documents.table(["", "what", "value", ""], rows))
    return DONE if all(finding.ok for finding in findings) else FAILED
