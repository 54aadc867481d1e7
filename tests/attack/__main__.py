"""``make attack``: every attack in its long form, a line each, and last one line of JSON.

python -m tests.attack [--only NAME ...] [--seed N] [--short]
"""

import argparse
import json
import sys
import time

from .catalogue import ATTACKS, load
from .outcome import Effort, Outcome


def main() -> int:
    """Run attacks; return 0 if all were withstood."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description="attack eitskin, and say what held")
    parser.add_argument("--only", nargs="+", choices=sorted(ATTACKS), metavar="NAME", help="these attacks only")
    parser.add_argument("--seed", type=int, default=0, help="of whatever an attack draws")
    parser.add_argument("--short", action="store_true", help="as short as in 'make test'")
    arguments = parser.parse_args()
    effort = Effort(long=not arguments.short, seed=arguments.seed)
    outcomes: list[Outcome] = []
    began = time.monotonic()
    for name in arguments.only or ATTACKS:
        started = time.monotonic()
        try:
            outcome = load(name)(effort)
        except Exception as error:  # the next attack must still be tried; this one counts as not withstood
            outcome = Outcome(name, tried=1, broken=[f"{type(error).__name__}: {error}"])
        outcome.figures["seconds"] = round(time.monotonic() - started, 1)
        outcomes.append(outcome)
        print(json.dumps(outcome.as_dict()), file=sys.stderr, flush=True)
    held = all(outcome.held for outcome in outcomes)
    print(
        json.dumps(
            {
                "attacks": len(outcomes),
                "tried": sum(outcome.tried for outcome in outcomes),
                "withstood": sum(outcome.withstood for outcome in outcomes),
                "frames_lost": sum(outcome.frames_lost for outcome in outcomes),
                "seconds": round(time.monotonic() - began, 1),
                "broken": [outcome.attack for outcome in outcomes if not outcome.held],
                "seed": arguments.seed,
            }
        )
    )
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
