"""Controls of the page in their order, without their actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from graceful_plan.costs.fault_prior import DEGREES
from graceful_plan.viewer.browser.recorded_tab import RecordedTab
from graceful_plan.viewer.recorded import RecordedRollouts

HIDDEN, GHOST, BESIDE = "hidden", "as a ghost", "beside it"
"""Display modes of the other motions."""
_MOST_WEIGHT = 2.0
_NONE = ("none",)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Controls:
    """Handles of all inputs and texts."""

    time: Any
    play: Any
    speed: Any
    w: Any
    plan_text: Any
    now_text: Any
    chart_folder: Any
    start: Any
    goal: Any
    handles: Any
    other: Any
    keep: Any
    let_go: Any
    entity: Any
    severity: Any
    move: Any
    fault: Any
    degree: Any
    moment: Any
    fail: Any
    heal: Any
    failure_text: Any
    footprint: Any
    risk_map: Any
    renew: Any
    names: Any
    dark: Any
    recorded: RecordedTab | None

    def offer(self, entities: Sequence[str], faults: Sequence[str]) -> None:
        """Set the entities and faults to choose from."""
        for handle, names in ((self.entity, tuple(entities) or _NONE), (self.fault, tuple(faults))):
            if tuple(handle.options) != names:
                handle.options = names
        for handle in (self.entity, self.severity, self.move):
            handle.disabled = not entities


def build(
    server: Any,
    *,
    w: float,
    entities: Sequence[str],
    faults: Sequence[str],
    dark: bool,
    rollouts: RecordedRollouts | None = None,
) -> Controls:
    """Create all controls on the page."""
    gui = server.gui
    found: dict[str, Any] = {
        "play": gui.add_button("Play"),
        "time": gui.add_slider("Time [s]", 0.0, 1.0, 0.01, 0.0),
        "w": gui.add_slider("w", 0.0, max(_MOST_WEIGHT, w), 0.01, w, hint="Safety weight; 0 is an ordinary planner"),
        "plan_text": gui.add_html(""),
        "chart_folder": gui.add_folder("Impact by entity, over time"),
        "now_text": gui.add_html(""),
    }
    tabs = gui.add_tab_group()
    found["recorded"] = None if rollouts is None else RecordedTab(gui, tabs, rollouts)
    with tabs.add_tab("Plan"):
        found |= {
            "other": gui.add_dropdown("Others are", (GHOST, BESIDE, HIDDEN), initial_value=GHOST),
            "keep": gui.add_button("Keep this motion"),
            "let_go": gui.add_button("Let go of those kept", visible=False),
            "handles": gui.add_checkbox("Handles to drag", True),
            "start": gui.add_vector3("Start [m]", (0.0, 0.0, 0.0), step=0.005),
            "goal": gui.add_vector3("Goal [m]", (0.0, 0.0, 0.0), step=0.005),
            "speed": gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0),
        }
    with tabs.add_tab("Things"):
        names = tuple(entities) or _NONE
        found |= {
            "entity": gui.add_dropdown("Entity", names, disabled=not entities),
            "severity": gui.add_number("Severity", 0.0, min=0.0, step=0.5, disabled=not entities),
            "move": gui.add_checkbox("Handle to move it", False, disabled=not entities),
            "names": gui.add_checkbox("Names in the scene", False),
        }
    with tabs.add_tab("Failure"):
        found |= {
            "fault": gui.add_dropdown("Fault", tuple(faults)),
            "degree": gui.add_dropdown("Degree", DEGREES, initial_value="severe"),
            "moment": gui.add_slider("Moment [%]", 0, 100, 1, 50),
            "fail": gui.add_button("Let it fail", color="red"),
            "heal": gui.add_button("Healthy motion again", visible=False),
            "failure_text": gui.add_html(""),
        }
    with tabs.add_tab("View"):
        found |= {
            "footprint": gui.add_checkbox("Footprint of a failure now", True),
            "risk_map": gui.add_checkbox("Risk map", False),
            "renew": gui.add_button("Risk map of this moment", disabled=True),
            "dark": gui.add_checkbox("Dark", dark),
        }
    return Controls(**found)
