"""A dropdown of frames that come and go."""

from collections.abc import Callable, Sequence
from typing import Any

import viser

# A list in a browser that is longer than this is slow, and nobody reads it: the filter narrows it.
MOST = 300


class FrameChoice:
    """Lets one of the frames be chosen; `nothing` is the first entry, for none of them.

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
        # viser's handles let their value be set, which mypy does not see.
        self._dropdown: Any = gui.add_dropdown(label, (nothing,), hint=hint)

        @self._dropdown.on_update
        def _(event: Any) -> None:
            # What the program sets has no client.
            if event.client is not None:
                value = self._dropdown.value
                on_choice("" if value == self._nothing else value)

    def show(self, names: Sequence[str], chosen: str, nothing: str | None = None) -> None:
        """Offer these frames, of which this one is chosen."""
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
