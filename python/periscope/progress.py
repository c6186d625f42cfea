"""Progress of a run: the bar of tqdm, in terminals and notebooks."""

from __future__ import annotations

import importlib.util
import json
import sys
from typing import Any

from .optional import need


def is_watched() -> bool:
    """Whether someone looks at a bar, and tqdm is there to draw it."""
    is_shown = "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())
    return is_shown and importlib.util.find_spec("tqdm") is not None


class Bar:
    """A bar for each pass of a run. `run` calls it with each event, as `periscope run --progress json` prints it."""

    def __init__(self) -> None:
        self.tqdm: Any = need("tqdm.auto", 'progress="tqdm"').tqdm
        self.bar: Any = None

    def __call__(self, text: str) -> None:
        event: dict[str, Any] = json.loads(text)
        if event["event"] == "pass":
            self.close()
            description = f"[{event['whole']}/{event['wanted']}] {', '.join(event['tables'])}"
            unit = {"bytes": "B", "rows": " rows"}[event["unit"]]
            self.bar = self.tqdm(total=event["of"], desc=description, unit=unit, unit_scale=True, leave=False)
        elif self.bar is not None:
            self.bar.update(event["read"] - self.bar.n)
            if event["event"] == "done":
                self.close()

    def close(self) -> None:
        """Takes the bar away."""
        if self.bar is not None:
            # A bar draws itself ten times a second: a short pass would end as it began.
            self.bar.refresh()
            self.bar.close()
            self.bar = None
