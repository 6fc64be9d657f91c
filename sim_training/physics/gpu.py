"""PhysX on a GPU: a library of its own, which SAPIEN downloads when it is first wanted."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import sapien

from resync_robot.core.errors import TrainingError


def gpu_physics_path() -> Path:
    """Where SAPIEN keeps the library."""
    return Path.home() / ".sapien" / "physx" / sapien.physx.version() / "libPhysXGpu_64.so"


def require_gpu_physics() -> None:
    """Load the library, after a download where this is the first time.

    Raises:
        TrainingError: it can neither be found nor downloaded, or it does not load.
    """
    path = gpu_physics_path()
    try:
        sapien.physx.enable_gpu()
    # OSError: no answer, no room, or it does not load. BadZipFile: what answered was no archive. RuntimeError: there is
    # none for this platform.
    except (OSError, BadZipFile, RuntimeError) as error:
        why = f"{type(error).__name__}: {str(error).splitlines()[0][:160]}" if str(error) else type(error).__name__
        raise TrainingError(
            f"--device cuda: GPU physics needs {path}, which SAPIEN downloads at first use, and that failed ({why})",
            f"on a machine with internet fetch linux-so.zip of release {sapien.physx.version()} from "
            f"https://github.com/sapien-sim/physx-precompiled/releases and unpack it in {path.parent}; "
            "or use --device cpu",
        ) from None
