"""Friction laws of [G] 3.1.1."""

from ideal_robot.friction.laws import (
    LAWS,
    Arctan,
    Asymmetric,
    BellStribeck,
    CubeRoot,
    FrictionModel,
    PerJointFriction,
    Stribeck,
    ViscousCoulomb,
    law_of,
)

__all__ = ["LAWS", "Arctan", "Asymmetric", "BellStribeck", "CubeRoot", "FrictionModel", "PerJointFriction", "Stribeck",
           "ViscousCoulomb", "law_of"]
