"""JSON schemas of a recording's texts, by the last part of their channel's name."""

from __future__ import annotations

from typing import Any


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": sorted(properties)}


def _array(items: Any, length: int | None = None) -> dict[str, Any]:
    bounds = {} if length is None else {"minItems": length, "maxItems": length}
    return {"type": "array", "items": items, **bounds}


_TEXT, _ANY, _NUMBER, _COUNT = {"type": "string"}, {"type": "object"}, {"type": ["number", "null"]}, {"type": "integer"}
_SIX, _OBJECTS = _array(_NUMBER, 6), _object(objects=_ANY)
SCHEMAS = {
    "meta": _object(
        format=_COUNT, rig_hash=_TEXT, rig=_ANY, library_hash=_TEXT, domain=_TEXT, scenario=_TEXT, goal=_TEXT,
        seed=_COUNT, backend=_TEXT, versions=_ANY, frames=_ANY, began=_TEXT, objects=_ANY, settings=_ANY,
        types=_ANY, model=_ANY,
    ),
    "joints": _object(
        measured=_SIX, velocity=_SIX, opening=_NUMBER, sent=_SIX, sent_opening=_NUMBER, requested=_SIX,
        requested_opening=_NUMBER,
    ),
    "tip_force": _object(force=_array(_NUMBER, 3)),
    "state": _OBJECTS,
    "truth": _OBJECTS,
    "atoms": _object(atoms={"type": "object", "additionalProperties": _NUMBER}),
    "plan": _object(steps=_array(_TEXT), current={"type": ["integer", "null"]}, reason=_TEXT),
    "answer": _object(ask=_TEXT, clock=_NUMBER, target=_SIX, target_opening=_NUMBER, details=_ANY),
    "timing": _object(picture=_NUMBER, asked=_NUMBER, due=_NUMBER, computed=_NUMBER),
    "event": _object(kind=_TEXT, text=_TEXT, details=_ANY),
    "info": _object(
        intrinsics=_array(_array(_NUMBER, 3), 3), world_T_cam=_array(_array(_NUMBER, 4), 4), width=_COUNT,
        height=_COUNT, depth_unit_m=_NUMBER,
    ),
}  # fmt: skip
