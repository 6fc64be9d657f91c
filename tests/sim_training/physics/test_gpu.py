"""The library of GPU physics: where it cannot be had, the error says what to fetch and where to put it."""

from zipfile import BadZipFile

import pytest
import sapien

from resync_robot.core.errors import TrainingError
from resync_robot.sim_training.physics.gpu import gpu_physics_path, require_gpu_physics


@pytest.mark.parametrize(
    "reason", [ConnectionError("no route to host\nand more"), BadZipFile("no zip"), OSError(), RuntimeError("no GPU")]
)
def test_what_hinders_is_an_error_that_says_what_to_do(reason: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def enable() -> None:
        raise reason

    monkeypatch.setattr(sapien.physx, "enable_gpu", enable)
    with pytest.raises(TrainingError) as caught:
        require_gpu_physics()
    assert str(gpu_physics_path()) in caught.value.what
    assert type(reason).__name__ in caught.value.what and "and more" not in caught.value.what
    assert sapien.physx.version() in caught.value.fix and "--device cpu" in caught.value.fix


def test_a_library_that_loads_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sapien.physx, "enable_gpu", lambda: None)
    require_gpu_physics()
