"""Calls one function in this process: python -m benchmarks.bus.run MODULE:FUNCTION JSON."""

import importlib
import json
import sys

module, _, function = sys.argv[1].partition(":")
getattr(importlib.import_module(f"benchmarks.bus.{module}"), function)(**json.loads(sys.argv[2]))
