"""The model card of a camera policy: what Hugging Face reads, what is true of the policy, and code that runs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from huggingface_hub import ModelCard

from resync_robot.core.errors import LibraryError
from resync_robot.core.library import CARD, Library, load_library, save_library
from resync_robot.curriculum.model_card import main, with_card
from resync_robot.library_models import shipped_library
from resync_robot.sim_training.domains import find_domain
from tests.libraries import DOMAIN, given_library, with_camera_policy

CORNERED = find_domain(DOMAIN)
AGAIN = f"write it anew: python -m resync_robot.curriculum.model_card {shipped_library(DOMAIN)}"


@pytest.fixture(scope="module")
def shipped() -> Library:
    return load_library(shipped_library(DOMAIN))


def card_of(library: Library) -> str:
    return library.policies[CORNERED.recovery][CARD].decode()


def test_the_shipped_library_has_the_card_that_this_program_writes(shipped: Library) -> None:
    assert CARD in shipped.policies[CORNERED.recovery], AGAIN
    assert card_of(shipped) == card_of(with_card(shipped, CORNERED)), AGAIN


def test_hugging_face_reads_its_front_matter(shipped: Library) -> None:
    data = ModelCard(card_of(with_card(shipped, CORNERED))).data
    assert (data.license, data.library_name, data.pipeline_tag) == ("apache-2.0", "lerobot", "robotics")
    assert "lerobot" in data.tags and data.datasets == ["local/recoveries"]


def test_it_says_what_goes_in_what_comes_out_and_what_was_measured(shipped: Library) -> None:
    library = with_card(shipped, CORNERED)
    text = card_of(library)
    config = json.loads(library.policies[CORNERED.recovery]["config.json"])
    for name, feature in (config["input_features"] | config["output_features"]).items():
        kind = "observation.images.{front, side, wrist}" if "images" in name else name
        assert f"| `{kind}` | {'x'.join(map(str, feature['shape']))} |" in text
    assert "joint_0_rad" in text and "forward_m" in text and "10 steps a second" in text
    figures = library.stage(CORNERED.recovery).figures["distil"]
    for point in figures["points"]:
        kept = ", kept" if point["step"] == figures["chosen"] else ""
        assert re.search(
            rf"\| {point['step']}{kept} \| {point['success']} of {point['worlds']} \[0\.\d\d, \d\.\d\d\] \|", text
        )


def test_a_card_changes_no_behaviour_and_so_no_hash(shipped: Library, tmp_path: Path) -> None:
    bare = replace(shipped, policies={"Recover": {n: d for n, d in shipped.policies["Recover"].items() if n != CARD}})
    carded = with_card(bare, CORNERED)
    assert CARD not in bare.policies["Recover"] and carded.content_hash == bare.content_hash == shipped.content_hash
    save_library(bare, tmp_path / "library")
    main(tmp_path / "library")
    found = load_library(tmp_path / "library")
    assert found.policies == carded.policies and found.content_hash == bare.content_hash
    (tmp_path / "library" / "policies" / "Recover" / CARD).write_text("It never fails.")
    with pytest.raises(LibraryError, match=r"README\.md was truncated or altered"):
        load_library(tmp_path / "library")


def test_what_has_no_policy_gets_no_card_and_what_is_no_policy_is_refused() -> None:
    bare = given_library()
    assert with_card(bare, CORNERED) is bare
    with pytest.raises(LibraryError, match=r"no config\.json that LeRobot would read"):
        with_card(with_camera_policy(1, 1), CORNERED)


@pytest.mark.slow
def test_its_code_loads_the_policy_in_stock_lerobot_and_not_without_the_import(shipped: Library) -> None:
    code = re.search(r"```python\n(.*?)```", card_of(with_card(shipped, CORNERED)), re.DOTALL)[1]
    config = json.loads(shipped.policies["Recover"]["config.json"])
    states = config["input_features"]["observation.state"]["shape"][0]
    given = (
        "import torch\n"
        "observation = {f'observation.images.{v}': torch.rand(3, 64, 64) for v in ('front', 'side', 'wrist')}\n"
        f"observation['observation.state'] = torch.rand({states})\n"
    )
    ran = _python(given + code + "print('ACTION', tuple(action.shape))\n")
    assert "ACTION (1, 3)" in ran.stdout, ran.stderr
    without = _python(given + code.partition("\n")[2])
    assert without.returncode != 0 and "resnet_resync_small" in without.stderr


def _python(code: str) -> subprocess.CompletedProcess[str]:
    """In the library's folder, where `policies` is no package of ours."""
    root = Path(__file__).parents[2]
    start = f"import sys; sys.path[:] = [{str(root)!r}, *sys.path[1:]]\n"
    return subprocess.run(
        [sys.executable, "-c", start + code], cwd=shipped_library(DOMAIN), capture_output=True, text=True, check=False
    )
