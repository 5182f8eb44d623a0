"""Run random histories: python -m tests.simulation [--seeds N] [--from SEED] [--seconds S]."""

import argparse
import logging
import random
import sys
import time
from contextlib import ExitStack

from tests.simulation.histories import shrunk, violation
from tests.simulation.message_log import logged
from tests.simulation.plans import LARGE, SMALL, Plan


def main() -> None:
    """Run them until one fails, which is printed with its seed, as small as it gets."""
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # coroutines of killed processes
    options = _options()
    first = random.SystemRandom().randrange(2**40) if options.fresh else options.first
    if options.shrink is not None:
        plan = _plan(options, options.shrink)
        if (found := violation(plan)) is None:
            sys.exit(f"seed {plan.seed} violates no law")
        _report(options, plan, found)
        sys.exit(1)
    begun, done, failed = time.monotonic(), 0, 0
    with ExitStack() as stack:
        if options.log:
            stack.enter_context(logged(stack.enter_context(open(options.log, "w"))))
        for seed in range(first, first + options.seeds):
            if time.monotonic() - begun > options.seconds:
                break
            plan = _plan(options, seed)
            found = violation(plan)
            done += 1
            if found:
                failed += 1
                _report(options, plan, found)
                if not options.go_on:
                    break
    took_s = time.monotonic() - begun
    kind = "large histories" if options.large else "histories"
    print(f"{done} {kind} from seed {first} in {took_s:.1f} s, {failed} failed")
    sys.exit(bool(failed))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10**9, help="at most so many histories")
    parser.add_argument("--from", dest="first", type=int, default=0, help="the first seed")
    parser.add_argument("--fresh", action="store_true", help="the system draws the first seed")
    parser.add_argument("--seconds", type=float, default=1e9, help="begin none after this time")
    parser.add_argument("--large", action="store_true", help="an hour of 200 processes each")
    parser.add_argument("--only", metavar="N,N", help="of the actions only these")
    parser.add_argument("--shrink", type=int, metavar="SEED", help="make a known one smaller")
    parser.add_argument("--no-shrink", action="store_true")
    parser.add_argument("--go-on", action="store_true", help="also after one that failed")
    parser.add_argument("--log", metavar="FILE", help="write all that is sent into a file")
    return parser.parse_args()


def _plan(options: argparse.Namespace, seed: int) -> Plan:
    plan = Plan.drawn(seed, LARGE if options.large else SMALL)
    if options.only is not None:
        plan = plan.only(plan.actions[int(number)] for number in options.only.split(",") if number)
    return plan


def _report(options: argparse.Namespace, plan: Plan, found: str) -> None:
    large = " --large" if options.large else ""
    again = f"python -m tests.simulation{large} --seeds 1 --no-shrink --from {plan.seed}"
    print(f"seed {plan.seed} violates:\n{found}\nagain: {again}", flush=True)
    if options.no_shrink:
        return
    smallest = shrunk(plan)
    every = Plan.drawn(plan.seed, plan.size).actions
    numbers = ",".join(str(every.index(action)) for action in smallest.actions)
    print(f"smallest:\n{violation(smallest)}\nagain: {again} --only {numbers}", flush=True)


if __name__ == "__main__":
    main()
