"""`angler validate`: the physics, measured again against independent references."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

EXIT_WORSE = 1


def validate(
    quick: bool = False,
    from_: Annotated[Path | None, tyro.conf.arg(name="from")] = None,
    page: bool = False,
    check: bool = False,
    store: bool = False,
    out: Path | None = None,
) -> None:
    """Measure every term against its reference, compare with the stored results, write the page.

    Runs the measuring tests, and studies of convergence, engines and precision. Exits with 1 and a
    line for each number that got worse. Needs a checkout.

    Args:
        quick: Run only short measurements with few worlds; the page keeps the other results.
        from_: Use measurements of earlier tests (pytest --deviations FILE, as make test does), and
            run nothing.
        page: Measure nothing; write the page again from stored results.
        check: Compare only, also the page with its source; nothing is written.
        store: Store the results as the new expected values, also where they got worse.
        out: Folder for validation.md and validation.json; docs/generated and docs/validation of
            the checkout if left out.
    """
    from angler_mjx.testing.validation import terms
    from angler_mjx.testing.validation.validate import ValidationRequest
    from angler_mjx.testing.validation.validate import run_validation as run

    request = ValidationRequest(
        quick=quick, measured=from_, page_only=page, check=check, store=store, out=out
    )
    bad = run(request, terms.find_checkout(), lambda line: print(line, file=sys.stderr, flush=True))
    for fault in bad:
        print(f"angler validate: {fault}")
    if bad:
        sys.exit(EXIT_WORSE)
    print("angler validate: nothing got worse")
