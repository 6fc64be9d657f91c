"""The adapter, against replies of the documented shape: boolean masks (n, 1, H, W), scores and boxes on a device."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import Rig, Sam3Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception import sam3
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.objects import SceneEstimator
from resync_robot.perception.segment import ColourSegmenter
from tests.perception.raycast import FLOOR, Table

PROMPTS = {"b0": "red block", "b1": "blue block"}
SHAPE = (24, 32)


def frame() -> CameraFrame:
    colour = np.zeros((*SHAPE, 3), np.uint8)
    return CameraFrame("wrist", colour, np.full(SHAPE, 5000, np.uint16), np.eye(3), np.eye(4), 0.0)


def reply(*entries: tuple[slice, slice, float]) -> dict[str, torch.Tensor]:
    """As SAM 3 gives it, scores in half precision."""
    masks = torch.zeros((len(entries), 1, *SHAPE), dtype=torch.bool)
    for mask, (rows, columns, _) in zip(masks, entries, strict=True):
        mask[0, rows, columns] = True
    scores = torch.tensor([s for *_, s in entries], dtype=torch.bfloat16)
    return {"masks": masks, "scores": scores, "boxes": torch.zeros((len(entries), 4), dtype=torch.bfloat16)}


def recorded(**replies: dict[str, torch.Tensor]) -> sam3.Ask:
    def ask(picture: Any, prompts: list[str]) -> list[Mapping[str, Any]]:
        assert picture.size == (SHAPE[1], SHAPE[0])
        return [replies.get(p.split()[0], reply()) for p in prompts]

    return ask


def test_every_instance_is_a_segment_and_doubtful_ones_are_none() -> None:
    red = reply((slice(2, 8), slice(2, 8), 0.9), (slice(12, 20), slice(2, 8), 0.7), (slice(0, 9), slice(20, 30), 0.3))
    segments = sam3.Sam3Segmenter(PROMPTS, recorded(red=red)).segment(frame())
    assert [s.label for s in segments] == ["b0", "b0"]
    assert segments[0].mask.dtype == bool and segments[0].mask.sum() == 36 and segments[0].mask[2, 2]


def test_a_pixel_belongs_to_the_better_score() -> None:
    red, blue = reply((slice(0, 10), slice(0, 20), 0.6)), reply((slice(0, 10), slice(10, 30), 0.8))
    segments = {s.label: s.mask for s in sam3.Sam3Segmenter(PROMPTS, recorded(red=red, blue=blue)).segment(frame())}
    assert not np.any(segments["b0"] & segments["b1"])
    assert segments["b1"].sum() == 200 and segments["b0"].sum() == 100


@pytest.mark.parametrize(
    "answer",
    [
        {},
        {"masks": torch.zeros(1, 1, 5, 5), "scores": torch.ones(1)},
        {"masks": torch.zeros(1, 1, *SHAPE), "scores": torch.ones(2)},
    ],
)
def test_a_reply_of_another_shape_is_one_error(answer: dict[str, torch.Tensor]) -> None:
    with pytest.raises(PerceptionError, match="SAM 3 answered"):
        sam3.Sam3Segmenter(PROMPTS, recorded(red=answer)).segment(frame())


def test_poses_from_its_masks_are_those_from_colour(rig: Rig, catalogue: Catalogue) -> None:
    table = Table(rig, catalogue)
    table.block("b0", 0.45, 0.05, FLOOR, 0.2, 0.060, 0.045)
    frames = table.scan()
    colour = ColourSegmenter(catalogue)
    waiting = iter(frames)

    def ask(picture: Any, prompts: list[str]) -> list[Mapping[str, Any]]:
        segments = [s for s in colour.segment(next(waiting)) if s.label == "b0"]
        masks = torch.from_numpy(np.array([s.mask for s in segments]).reshape(-1, 1, *frames[0].depth.shape))
        return [{"masks": masks, "scores": torch.ones(len(masks))}]

    asked = SceneEstimator(rig, catalogue, sam3.Sam3Segmenter({"b0": "red block"}, ask)).estimate(frames)
    plain = SceneEstimator(rig, catalogue).estimate(frames)
    np.testing.assert_allclose(asked.blocks["b0"].features, plain.blocks["b0"].features, atol=1e-9)


def test_what_is_absent_is_one_error_that_says_where_it_comes_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(PerceptionError, match=r"no \[sam3\] table"):
        sam3.sam3_segmenter(None, Catalogue())
    settings = Sam3Rig(checkpoint=tmp_path / "sam3.pt", vocabulary=tmp_path / "bpe.gz", prompts=PROMPTS)
    with pytest.raises(UnknownNameError, match="b9"):
        sam3.sam3_segmenter(replace(settings, prompts={"b9": "pink block"}), Catalogue())
    monkeypatch.setattr(sam3.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(PerceptionError, match=r"sam3 is not installed(.|\n)*uv pip install"):
        sam3.sam3_segmenter(settings, Catalogue())
    monkeypatch.setattr(sam3.importlib.util, "find_spec", lambda name: object())
    with pytest.raises(PerceptionError, match=r"checkpoint(.|\n)*huggingface(.|\n)*SAM License"):
        sam3.sam3_segmenter(settings, Catalogue())
    settings.checkpoint.touch()
    with pytest.raises(PerceptionError, match=r"vocabulary(.|\n)*facebookresearch"):
        sam3.sam3_segmenter(settings, Catalogue())
    settings.vocabulary.touch()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(PerceptionError, match="CUDA"):
        sam3.sam3_segmenter(settings, Catalogue())
    assert "sam3" not in sys.modules
