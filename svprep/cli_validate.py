"""What ``svprep validate`` says of the checks it made."""

from __future__ import annotations

from typing import Any

from svprep.validate import Validation, problem_lines


def summary(outcome: Validation) -> dict[str, Any]:
    """Return what ``--json`` prints."""
    return {
        "cache": outcome.path,
        "valid": outcome.is_valid,
        "deep": outcome.is_deep,
        "checks": list(outcome.checks),
        "problems": [
            {"code": p.code, "where": p.where, "message": p.message} for p in outcome.problems
        ],
    }


def lines(outcome: Validation) -> list[str]:
    """Return the lines that people read."""
    n = len(outcome.problems)
    return [
        *(f"checked  {line}" for line in outcome.checks),
        *(f"failed   {line}" for line in problem_lines(outcome)),
        "valid" if n == 0 else f"not valid: {n} problem{'' if n == 1 else 's'}",
    ]
