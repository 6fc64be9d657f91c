"""Names, types and wire format of the RTDE variables. Source: the manufacturer's RTDE guide.

All numbers are big-endian. Joints are base to wrist 3; poses and forces are in the arm's base frame.
"""

from __future__ import annotations

import struct
from typing import Any

Value = Any
"""A number, or a tuple of six or three numbers."""

FORMATS = {
    "BOOL": struct.Struct(">?"),
    "UINT8": struct.Struct(">B"),
    "UINT32": struct.Struct(">I"),
    "UINT64": struct.Struct(">Q"),
    "INT32": struct.Struct(">i"),
    "DOUBLE": struct.Struct(">d"),
    "VECTOR3D": struct.Struct(">3d"),
    "VECTOR6D": struct.Struct(">6d"),
    "VECTOR6INT32": struct.Struct(">6i"),
    "VECTOR6UINT32": struct.Struct(">6I"),
}
LENGTHS = {"VECTOR3D": 3, "VECTOR6D": 6, "VECTOR6INT32": 6, "VECTOR6UINT32": 6}

NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

_SIX = """target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current
    actual_current_window joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose
    target_TCP_speed joint_temperatures actual_joint_voltage payload_inertia ft_raw_wrench actual_current_as_torque"""
_NUMBERS = """timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage
    actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 standard_analog_output0
    standard_analog_output1 io_current tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature
    tcp_force_scalar payload joint_position_deviation_ratio collision_detection_ratio"""
_WORDS = """runtime_state robot_status_bits safety_status_bits analog_io_types euromap67_input_bits
    euromap67_output_bits tool_mode tool_analog_input_types output_bit_registers0_to_31 output_bit_registers32_to_63
    input_bit_registers0_to_31 input_bit_registers32_to_63 script_control_line"""

OUTPUTS: dict[str, str] = {
    **dict.fromkeys(_SIX.split(), "VECTOR6D"),
    **dict.fromkeys(_NUMBERS.split(), "DOUBLE"),
    **dict.fromkeys(_WORDS.split(), "UINT32"),
    **dict.fromkeys(
        ("robot_mode", "safety_mode", "safety_status", "tool_output_voltage", "time_scale_source"), "INT32"
    ),
    **dict.fromkeys(("tool_output_mode", "tool_digital_output0_mode", "tool_digital_output1_mode"), "UINT8"),
    **dict.fromkeys(("actual_digital_input_bits", "actual_digital_output_bits"), "UINT64"),
    **dict.fromkeys(("actual_tool_accelerometer", "elbow_position", "elbow_velocity", "payload_cog"), "VECTOR3D"),
    "joint_mode": "VECTOR6INT32",
}
INPUTS: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    **dict.fromkeys(
        (
            "standard_digital_output_mask",
            "configurable_digital_output_mask",
            "standard_digital_output",
            "configurable_digital_output",
            "tool_digital_output_mask",
            "tool_digital_output",
            "standard_analog_output_mask",
            "standard_analog_output_type",
        ),
        "UINT8",
    ),
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "external_force_torque": "VECTOR6D",
}
REGISTERS = 48
"""General purpose registers of each kind, 0 to 47; the bit registers go from 64 to 127."""
for _side, _table in (("output", OUTPUTS), ("input", INPUTS)):
    for _i in range(REGISTERS):
        _table[f"{_side}_int_register_{_i}"] = "INT32"
        _table[f"{_side}_double_register_{_i}"] = "DOUBLE"
    for _i in range(64, 128):
        _table[f"{_side}_bit_register_{_i}"] = "BOOL"
for _name in [n for n in INPUTS if "register" in n]:
    OUTPUTS.setdefault(_name, INPUTS[_name])


class Recipe:
    """An agreed list of variables: packs and unpacks the body of a data package.

    Attributes:
        names: the variables, in order.
        types: type of each, or NOT_FOUND or IN_USE; a recipe with one of those cannot be used.
    """

    def __init__(self, names: tuple[str, ...], types: tuple[str, ...]) -> None:
        self.names, self.types = names, types
        self.usable = all(t in FORMATS for t in types)
        self._format = struct.Struct(">" + "".join(FORMATS[t].format[1:] for t in types)) if self.usable else None
        self._counts = [LENGTHS.get(t, 1) for t in types]

    def pack(self, values: dict[str, Value]) -> bytes:
        """The body for these values; what is absent counts as zero. Raises struct.error on a value out of range."""
        flat: list[Any] = []
        for name, count in zip(self.names, self._counts, strict=True):
            value = values.get(name)
            if count == 1:
                flat.append(0 if value is None else value)
            else:
                flat.extend((0,) * count if value is None else value)
        if self._format is None:
            raise struct.error("a recipe with unknown variables")
        return self._format.pack(*flat)

    def unpack(self, body: bytes) -> dict[str, Value]:
        """Values by name. Raises struct.error where the body has another length."""
        if self._format is None:
            raise struct.error("a recipe with unknown variables")
        flat = self._format.unpack(body)
        values, at = {}, 0
        for name, count in zip(self.names, self._counts, strict=True):
            values[name] = flat[at] if count == 1 else flat[at : at + count]
            at += count
        return values
