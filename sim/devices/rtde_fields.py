"""Fields of Universal Robots' Real-Time Data Exchange and their types, as its public description lists them."""

from __future__ import annotations

import re

CODES = {"BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
         "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}
"""How a value of a type stands in a data package."""
_OUTPUTS = {
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    "UINT32": "runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode tool_analog_input_types "
              "output_bit_registers0_to_31 output_bit_registers32_to_63 input_bit_registers0_to_31 "
              "input_bit_registers32_to_63 script_control_line",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage",
    "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage "
              "actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 "
              "standard_analog_output0 standard_analog_output1 io_current tool_analog_input0 tool_analog_input1 "
              "tool_output_current tool_temperature tcp_force_scalar payload",
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
                "actual_current_window actual_current_as_torque joint_control_output actual_TCP_pose actual_TCP_speed "
                "actual_TCP_force target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage "
                "payload_inertia ft_raw_wrench",
    "VECTOR6INT32": "joint_mode"}
_INPUTS = {
    "UINT8": "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
             "configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask "
             "standard_analog_output_type",
    "UINT32": "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
    "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    "VECTOR6D": "external_force_torque"}
_REGISTER = re.compile(r"(?P<way>input|output)_(?P<kind>bit|int|double)_register_(?P<number>[0-9]{1,3})")
_REGISTERS = {"bit": ("BOOL", range(64, 128)), "int": ("INT32", range(48)), "double": ("DOUBLE", range(48))}


def count(kind: str) -> int:
    """How many numbers a value of a type has."""
    return int(CODES[kind][:-1] or 1)


def output_type(name: str) -> str | None:
    """Type of a field that a controller tells; None if it has no such field. It tells its inputs, too."""
    return _type(name, _OUTPUTS, ("output", "input"))


def input_type(name: str) -> str | None:
    """Type of a field that a client may write; None if there is none."""
    return _type(name, _INPUTS, ("input",))


def _type(name: str, fields: dict[str, str], ways: tuple[str, ...]) -> str | None:
    found = _REGISTER.fullmatch(name)
    if found is not None:
        kind, numbers = _REGISTERS[found["kind"]]
        return kind if found["way"] in ways and int(found["number"]) in numbers else None
    return next((kind for kind, names in fields.items() if name in names.split()), None)
