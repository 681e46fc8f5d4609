"""Rigid-body dynamics: regressor, base parameters, physical consistency."""

from ideal_robot.dynamics.base_parameters import BaseParameters, base_parameters, full_regressor
from ideal_robot.dynamics.regressor import link_parameters, regressor, torques, with_link_parameters

__all__ = ["BaseParameters", "base_parameters", "full_regressor", "link_parameters", "regressor", "torques",
           "with_link_parameters"]
