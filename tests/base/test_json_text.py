"""Values as JSON."""

import json
from math import inf, nan
from typing import Any, Never

import numpy as np
import pytest

from tfbus.base.json_text import json_text


def refused(name: str) -> Never:
    raise AssertionError(f"{name} is no JSON")


@pytest.mark.parametrize(
    ("value", "read"),
    [
        ({"rate_hz": nan, "ages": (1.5, -inf)}, {"rate_hz": None, "ages": [1.5, None]}),
        ({"points": np.array([[1.0, nan]])}, {"points": [[1.0, None]]}),
        (
            {"data": b"\x01", "maps": [{b"\xff": {b"a": 1}}]},
            {"data": "01", "maps": [{"ff": {"61": 1}}]},
        ),
        ({7: inf, "view": memoryview(b"ab")}, {"7": None, "view": "6162"}),
        (np.float64(inf), None),
    ],
)
def test_every_value_is_json_that_others_read(value: Any, read: Any) -> None:
    """Without NaN and Infinity, which JSON does not have; arrays are lists, and bytes digits."""
    assert json.loads(json_text(value), parse_constant=refused) == read
