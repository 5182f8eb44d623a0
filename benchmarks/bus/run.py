"""Calls one function in this process: python -m benchmarks.bus.run MODULE:FUNCTION JSON.

The module is one of this package, or one of another as `recordings.by_tfbus`.
"""

import importlib
import json
import sys

from benchmarks.bus import place  # noqa: F401  # it keeps the standard output, to say things on

# rospy's log lines, for one, go to the standard output.
sys.stdout = sys.stderr

module, _, function = sys.argv[1].partition(":")
path = f"benchmarks.{module}" if "." in module else f"benchmarks.bus.{module}"
getattr(importlib.import_module(path), function)(**json.loads(sys.argv[2]))
