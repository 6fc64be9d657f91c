"""An option that may be left out."""

from __future__ import annotations

from typing import Annotated, TypeVar

import tyro

T = TypeVar("T")
Given = Annotated[T | None, tyro.conf.arg(help_behavior_hint="")]
"""Of an option whose docstring says what happens without it: --help then has no word of `None`."""
Several = Annotated[tuple[T, ...], tyro.conf.arg(help_behavior_hint="")]
"""The same of one that takes several values, or none."""
