"""Friction laws of [G] 3.1.1."""

from ideal_robot.friction.base import FrictionModel
from ideal_robot.friction.laws import Arctan, Asymmetric, CubeRoot, Stribeck, ViscousCoulomb
from ideal_robot.friction.per_joint import LAWS, PerJointFriction, law_of

__all__ = ["LAWS", "Arctan", "Asymmetric", "CubeRoot", "FrictionModel", "PerJointFriction", "Stribeck",
           "ViscousCoulomb", "law_of"]
