"""What an examination found: of a machine, of a domain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        status: `fail` where something essential cannot work, `warn` where it can but something is off.
        fix: what mends it; empty where nothing has to be mended.
    """

    name: str
    status: Status
    detail: str
    fix: str = ""
