"""Conformance: scenes with known truth that a backend must reproduce, and the verdict on each measured number.

A backend's plugin offers `checks`; each one measures quantities beside their truth. Where a backend cannot do what is
asked, its plugin declares a `Limitation` with the cause; what is declared but measures well is a warning, so that the
declarations stay true.

* `check`: what a check is, and how what it measured is judged.
* `suite`: the checks of a backend, by its name or by a config.
* `runner`: many checks in child processes, which may crash or hang.
* `report`: the outcomes in the terminal.
* `page`: the capability page, docs/engines.md, and its machine-readable counterpart.
* `testing`: the checks as tests of pytest.
* `commands`: `imolo check`.
"""

from imolo.conformance.check import Check, Limitation, Measurement, Outcome, Verdict, run_check

__all__ = ["Check", "Limitation", "Measurement", "Outcome", "Verdict", "run_check"]
