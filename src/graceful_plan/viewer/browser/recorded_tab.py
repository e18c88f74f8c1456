"""Tab for selecting a rollout of a dataset: filters, rank by harm, description."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

from graceful_plan.viewer.browser import words
from graceful_plan.viewer.recorded import RecordedRollouts

_ANY = "any"


@final
class RecordedTab:
    """Controls for selecting a rollout.

    Args:
        tabs: Group of tabs to add it to.
        rollouts: Rollouts to choose from.
    """

    def __init__(self, gui: Any, tabs: Any, rollouts: RecordedRollouts) -> None:
        self.rollouts = rollouts
        with tabs.add_tab("Rollouts"):
            self._motion = gui.add_dropdown("Motion", (_ANY, *rollouts.motions))
            self._fault = gui.add_dropdown("Fault", (_ANY, *rollouts.faults))
            self._place = gui.add_slider("Place by harm", 1, len(rollouts), 1, 1, hint="1 is the most harmful one")
            self._text = gui.add_html("")
            self._show = gui.add_button("Let it happen again", color="red")
            self._told = gui.add_html("")
        self._filter()

    def connect(self, guarded: Callable[..., None], chosen: Callable[[int], None]) -> None:
        """Connect user actions.

        Args:
            guarded: Calls a function with arguments under a lock that excludes other browsers.
            chosen: Called with the number of the selected rollout.
        """
        for handle, act in ((self._motion, self._filter), (self._fault, self._filter), (self._place, self._describe)):
            handle.on_update(lambda event, act=act: guarded(act) if event.client is not None else None)
        self._show.on_click(lambda _: guarded(self._choose, chosen))

    def _choose(self, chosen: Callable[[int], None]) -> None:
        if len(self._order):
            chosen(self.number)

    def tell(self, text: str) -> None:
        """Show the predicted and observed harm, as HTML."""
        self._told.content = text

    @property
    def number(self) -> int:
        """Number of the described rollout."""
        return int(self._order[min(int(self._place.value), len(self._order)) - 1])

    def _filter(self) -> None:
        motions, faults = (() if field.value == _ANY else (field.value,) for field in (self._motion, self._fault))
        self._order = self.rollouts.worst_first(motions, faults)
        self._show.disabled = not len(self._order)
        self._place.disabled = len(self._order) < 2
        self._place.max = max(2, len(self._order))  # a slider needs two positions
        self._place.value = 1
        self._describe()

    def _describe(self) -> None:
        row = self.rollouts[self.number] if len(self._order) else None
        self._text.content = words.recorded_words(row, len(self._order))
