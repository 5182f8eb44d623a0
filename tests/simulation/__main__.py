"""Run random histories: python -m tests.simulation [--seeds N] [--from SEED] [--seconds S]."""

import argparse
import sys
import time

from tests.simulation.histories import Plan, shrunk, violation


def main() -> None:
    """Run them until one fails, which is printed with its seed, as small as it gets."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--no-shrink", action="store_true")
    parser.add_argument("--go-on", action="store_true")
    options = parser.parse_args()
    begun, done, failed = time.monotonic(), 0, 0
    for seed in range(options.first, options.first + options.seeds):
        if time.monotonic() - begun > options.seconds:
            break
        plan = Plan.drawn(seed)
        try:
            found = violation(plan)
        except Exception as error:  # printed with its seed
            found = f"{type(error).__name__}: {error}\n{plan}"
        done += 1
        if found:
            failed += 1
            print(f"seed {seed} violates:\n{found}")
            if not options.no_shrink:
                print("smallest:", shrunk(plan), violation(shrunk(plan)), sep="\n")
            if not options.go_on:
                break
    print(f"{done} histories in {time.monotonic() - begun:.1f} s, {failed} failed")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
