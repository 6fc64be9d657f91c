"""Masks from text by SAM 3, behind the same protocol as `segment.ColourSegmenter`.

Untested on real weights: they are gated, and nobody here has run them. The adapter is tested against replies of the
documented shape.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import Sam3Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.segment import Segment, as_rgb

INSTALL = "uv pip install -e '.[sam3]' -c constraints.txt"
KNOWN = f"install the version that is known: {INSTALL}"
SOURCE = "https://huggingface.co/facebook/sam3, under Meta's SAM License, which its page asks you to accept"
VOCABULARY = "https://github.com/facebookresearch/sam3 (assets/bpe_simple_vocab_16e6.txt.gz)"
LEAST_SCORE = 0.5
LEAST_PIXELS = 25

Ask = Callable[[Any, list[str]], list[Mapping[str, Any]]]
"""(picture, prompts) -> a reply for each prompt: `masks` (n, 1, H, W) bool, `scores` (n,), `boxes` (n, 4) px."""


class Sam3Segmenter:
    """One prompt for each kind of block.

    Args:
        prompts: label of a segment -> what to ask for, such as "red block".
        ask: the model; `load_sam3` by default reads it from disk.
    """

    def __init__(self, prompts: Mapping[str, str], ask: Ask) -> None:
        self._prompts, self._ask = dict(prompts), ask

    def segment(self, frame: CameraFrame) -> list[Segment]:
        """A segment for every instance; a pixel that several claim goes to the best score.

        Raises:
            PerceptionError: a picture that is no 8-bit RGB, or a reply of another shape than documented.
        """
        from PIL import Image

        colour = as_rgb(frame)
        replies = self._ask(Image.fromarray(colour), list(self._prompts.values()))
        found: list[tuple[float, str, np.ndarray]] = []
        for label, reply in zip(self._prompts, replies, strict=True):
            masks, scores = _read(reply, colour.shape[:2])
            found += [(float(s), label, m) for m, s in zip(masks, scores, strict=True) if s >= LEAST_SCORE]
        taken = np.zeros(colour.shape[:2], dtype=bool)
        segments = []
        for _, label, mask in sorted(found, key=lambda entry: -entry[0]):
            own = mask & ~taken
            taken |= mask
            if own.sum() >= LEAST_PIXELS:
                segments.append(Segment(label, own))
        return segments


def _read(reply: Mapping[str, Any], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(n, H, W) bool and (n,) of one reply, from the GPU where they are there. Raises PerceptionError."""
    try:
        masks, scores = (_array(reply[name]) for name in ("masks", "scores"))
    except (KeyError, TypeError) as error:
        raise PerceptionError(f"SAM 3 answered without {error}", KNOWN) from None
    if masks.ndim == 4 and masks.shape[1] == 1:
        masks = masks[:, 0]
    if masks.ndim != 3 or masks.shape[1:] != tuple(shape) or scores.shape != masks.shape[:1]:
        raise PerceptionError(
            f"SAM 3 answered with masks {masks.shape} and scores {scores.shape} for a picture of {shape}; (n, 1, H, W) "
            "and (n,) were expected",
            KNOWN,
        )
    return masks.astype(bool), scores.astype(np.float64)


def _array(value: Any) -> np.ndarray:
    if hasattr(value, "detach"):
        # Half precision, as the model gives it, means nothing to numpy.
        value = value.detach().float().cpu()
    return np.asarray(value)


def sam3_segmenter(settings: Sam3Rig | None, catalogue: Catalogue, where: str = "the rig file") -> Sam3Segmenter:
    """The segmenter that a rig file describes; a message names it as `where`.

    Raises:
        UnknownNameError: a prompt for a block that the catalogue does not have.
        PerceptionError: no `[sam3]` table, the package or a file is missing, or there is no CUDA device; and where
            to get it.
    """
    if settings is None:
        raise PerceptionError(
            f"{where} has no [sam3] table",
            'add one with checkpoint = "sam3.pt", vocabulary = "bpe_simple_vocab_16e6.txt.gz" and [sam3.prompts] '
            'b0 = "red block"; or use --segmenter colour',
        )
    names = [alike[0] for alike in catalogue.look_alikes]
    for name in settings.prompts:
        if name not in names:
            raise UnknownNameError("block", name, names, f"[sam3.prompts] of {where}")
    return Sam3Segmenter(settings.prompts, load_sam3(settings.checkpoint, settings.vocabulary))


def load_sam3(checkpoint: Path, vocabulary: Path) -> Ask:
    """The model on the first CUDA device. Raises PerceptionError as `sam3_segmenter` does."""
    if importlib.util.find_spec("sam3") is None:
        raise PerceptionError("the package sam3 is not installed", f"{INSTALL}; or use --segmenter colour")
    for what, path, source in (("checkpoint", checkpoint, SOURCE), ("vocabulary", vocabulary, VOCABULARY)):
        if not path.is_file():
            raise PerceptionError(f"the {what} of SAM 3 is not at {path}", f"it comes from {source}")
    import torch

    if not torch.cuda.is_available():
        raise PerceptionError("SAM 3 needs a CUDA device, and there is none", "use --segmenter colour")
    from sam3.model.sam3_image_processor import Sam3Processor
    from sam3.model_builder import build_sam3_image_model

    model = build_sam3_image_model(
        bpe_path=str(vocabulary), checkpoint_path=str(checkpoint), device="cuda", load_from_HF=False
    )
    processor = Sam3Processor(model, device="cuda")

    def ask(picture: Any, prompts: list[str]) -> list[Mapping[str, Any]]:
        with torch.inference_mode(), torch.autocast("cuda", dtype=torch.bfloat16):
            state = processor.set_image(picture)
            # The state is one dictionary that each prompt overwrites, so what is needed is copied out of it.
            return [
                {name: reply[name] for name in ("masks", "scores", "boxes")}
                for reply in (processor.set_text_prompt(prompt, state) for prompt in prompts)
            ]

    return ask
