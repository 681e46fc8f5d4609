"""Where effects act: the residual they are part of, and how its channels are named."""

from __future__ import annotations

from dataclasses import dataclass

from ideal_robot.errors import InputError


@dataclass(frozen=True)
class Domain:
    """One kind of measurement with its residual.

    Attributes:
        name: key.
        prefix: first part of its channels' names: ``tau`` for ``tau_1 … tau_n``.
        whole: what an effect belongs to that belongs to no joint, in words.
    """

    name: str
    prefix: str
    whole: str = "the whole arm"


MOTOR_TORQUE = Domain("motor_torque", "tau")
ARM_POSITION = Domain("arm_position", "qa")
TCP_POSITION = Domain("tcp_position", "tcp")
SENSOR = Domain("sensor", "line", "the sensor")
DOMAINS = (MOTOR_TORQUE, ARM_POSITION, TCP_POSITION, SENSOR)


def channel_name(prefix: str, joint: int) -> str:
    """Name of a joint's channel; of the whole arm for joint 0."""
    return f"{prefix}_{joint}" if joint else prefix


def domain_of(prefix: str) -> Domain:
    """The domain whose channels' names begin like that.

    Raises:
        InputError: there is none.
    """
    for domain in DOMAINS:
        if domain.prefix == prefix:
            return domain
    raise InputError(f"no such channel; known are those of {', '.join(d.prefix for d in DOMAINS)}", field="channel",
                     value=prefix)


def prefix_of(channel: str) -> str:
    """First part of a channel's name, without the joint's number."""
    first, _, tail = channel.rpartition("_")
    return first if tail.isdigit() else channel
