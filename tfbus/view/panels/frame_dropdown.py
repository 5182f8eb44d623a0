"""A dropdown of frames that come and go."""

from collections.abc import Callable, Sequence
from typing import Any

import viser

# A longer list is slow in a browser; the filter narrows it.
MOST = 300


class FrameDropdown:
    """A choice of one frame; the first entry, `nothing`, stands for none.

    `on_choice(name)` is called with the frame that a user has chosen, "" for none.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        nothing: str,
        on_choice: Callable[[str], object],
        hint: str | None = None,
    ) -> None:
        self._nothing = nothing
        # The value of viser's handles can be set, which mypy does not see.
        self._dropdown: Any = gui.add_dropdown(label, (nothing,), hint=hint)

        @self._dropdown.on_update
        def _(event: Any) -> None:
            # A change by the program has no client.
            if event.client is not None:
                value = self._dropdown.value
                on_choice("" if value == self._nothing else value)

    @property
    def order(self) -> float:
        """Its place in the tab: higher ones are below."""
        return float(self._dropdown.order)

    def show(self, names: Sequence[str], chosen: str, nothing: str | None = None) -> None:
        """Offer these frames, with this one chosen; `nothing` renames the first entry."""
        if nothing is not None:
            self._nothing = nothing
        listed = [*names[:MOST]]
        if chosen and chosen not in listed:
            listed.insert(0, chosen)
        options = (self._nothing, *listed)
        value = chosen or self._nothing
        if self._dropdown.options != options:
            self._dropdown.options = options
        if self._dropdown.value != value:
            self._dropdown.value = value
