"""Closed forms and scaling laws of the optic cup; NumPy only.

Every function broadcasts over arrays. "(3)" is an equation of the letter, "(S17)" one of its
supporting information; docs/theory.md states them all in the names used here.
"""

from opticcup_fem.theory.energy import (
    GrowthLoads,
    boundary_layer_energy,
    boundary_layer_rotation,
    edge_torque,
    growth_loads,
    koiter_energy,
    natural_forms,
)
from opticcup_fem.theory.natural import (
    cap_curvature,
    natural_curvature,
    natural_stretch,
    projected_energy,
)
from opticcup_fem.theory.plate import (
    chi,
    chi_small_growth,
    horizontal_curvature,
    plate_buckling_curvature,
    plate_buckling_curvature_by_energy,
    plate_buckling_curvature_of_stretch,
    plate_buckling_factor,
    snapping_limit,
    span,
)
from opticcup_fem.theory.prediction import (
    PredictedEvent,
    Prediction,
    cap_curvature_of_case,
    predict,
    time_of_curvature,
)
from opticcup_fem.theory.report import prediction_report
from opticcup_fem.theory.rigidity import (
    bending_rigidity,
    effective_modulus_ratio,
    equivalent_curvature,
    lame_moduli,
    membrane_rigidity,
    spring_ratio,
)
from opticcup_fem.theory.scaling import (
    PAPER_COEFFICIENTS,
    ScalingCoefficients,
    buckling_curvature,
    buckling_transition,
    primary_curvature,
    secondary_curvature,
    theta_bar,
)

__all__ = [
    "PAPER_COEFFICIENTS",
    "GrowthLoads",
    "PredictedEvent",
    "Prediction",
    "ScalingCoefficients",
    "bending_rigidity",
    "boundary_layer_energy",
    "boundary_layer_rotation",
    "buckling_curvature",
    "buckling_transition",
    "cap_curvature",
    "cap_curvature_of_case",
    "chi",
    "chi_small_growth",
    "edge_torque",
    "effective_modulus_ratio",
    "equivalent_curvature",
    "growth_loads",
    "horizontal_curvature",
    "koiter_energy",
    "lame_moduli",
    "membrane_rigidity",
    "natural_curvature",
    "natural_forms",
    "natural_stretch",
    "plate_buckling_curvature",
    "plate_buckling_curvature_by_energy",
    "plate_buckling_curvature_of_stretch",
    "plate_buckling_factor",
    "predict",
    "prediction_report",
    "primary_curvature",
    "projected_energy",
    "secondary_curvature",
    "snapping_limit",
    "span",
    "spring_ratio",
    "theta_bar",
    "time_of_curvature",
]
