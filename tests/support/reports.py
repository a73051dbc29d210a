"""Made-up results for the report: cups that obey the paper's laws, with paths and layers."""

from __future__ import annotations

import math

import numpy as np

from opticcup_fem.diagram.bisection import Bracket
from opticcup_fem.report.plan import SETS, SLITS
from opticcup_fem.report.results import Computed, Results
from opticcup_fem.studies.sweep.rows import empty_row
from opticcup_fem.theory import buckling_curvature, primary_curvature, secondary_curvature

GAMMA, PLATE = 0.05845, 4.167


def path():
    """Return a path with a fall between two computed states and a part that no cup follows."""
    t = np.array([0.0, 0.02, 0.04, 0.03, 0.035, 0.05, 0.1, 0.3, 0.5, 0.7, 1.0])
    followed = np.ones(len(t), bool)
    followed[3:5] = False
    jump = np.zeros(len(t), bool)
    jump[5] = True
    depth = np.array([0, 0, 0, 0.2, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8])
    return {
        "t_n": t.tolist(),
        "D_over_r": depth.tolist(),
        "lambda_iov": (1 + t / 2).tolist(),
        "apex_height_over_R": (2 - depth).tolist(),
        "max_radius_over_R": (1 + t).tolist(),
        "tangent_angle_interface": (0.7 - depth).tolist(),
        "followed": followed.tolist(),
        "jump": jump.tolist(),
        "limit_point": [False] * len(t),
    }


def cup(settings):
    """Return the record of a cup that obeys (3)-(5)."""
    ratio = float(settings.get("ratio", 5.0))
    alpha = math.radians(float(settings.get("alpha_deg", 40.0)))
    theta = alpha * math.sqrt(ratio)
    kappa_2 = float(secondary_curvature(ratio))
    kappa_b = float(buckling_curvature(theta, alpha, GAMMA, PLATE))
    row = {
        **empty_row(),
        "theta_bar": theta,
        "t_1": 0.04, "type_1": "fold", "kappa_1": float(primary_curvature(theta, GAMMA)),
        "delta_theta_1": alpha,
        "t_reached": 1.0, "D_over_r": 0.8, "lambda_iov": 1.5, "largest_D_over_r": 0.8,
        "D_over_r_at_0.4": 0.5,
    }  # fmt: skip
    if settings.get("modulus_ratio") == 10.0:
        row |= {"t_1": None, "kappa_1": None, "largest_D_over_r": 0.0}
    elif kappa_2 < kappa_b:
        row |= {"t_2": 0.4, "type_2": "smooth", "kappa_2": kappa_2, "delta_theta_2": 1.5}
    else:
        row |= {"t_b": 0.3, "type_b": "bifurcation", "kappa_b": kappa_b, "m_b": 2}
        row["delta_theta_b"] = 1.6
    return {"status": "ok", "reason": None, "row": row, "path": path()}


def layers(settings):
    """Return spherical layers at the output times."""
    states = []
    for t_n in settings["times"]:
        regions = {}
        for name, (low, high), names in (
            ("cap", (0.0, 0.7), ("iov", "ecm")),
            ("oov", (0.7, math.pi), ("oov",)),
        ):
            theta = np.linspace(low, high, 9)
            radii = np.linspace(0.9, 1.1, len(names) + 1)
            faces = np.stack([np.outer(np.sin(theta), radii), np.outer(np.cos(theta), radii)], -1)
            values = {layer: (1 + theta).tolist() for layer in names}
            regions[name] = {
                "theta": theta.tolist(),
                "faces": faces.tolist(),
                "stretch": values,
                "stress": values,
            }
        states.append({"t_n": t_n, "regions": regions})
    return {"status": "ok", "reason": None, "states": states}


def results():
    """Return every set of the plan, made up."""
    found = Results()
    for name, plan in SETS.items():
        kinds = {
            "plate": lambda s: plate(s["ratio"]),
            "layers": layers,
            "coexistence": coexistence,
        }
        found.sets[name] = [
            Computed(one.settings, kinds.get(one.task.kind, cup)(one.settings)) for one in plan()
        ]
    found.transitions = {
        "theta_b 40": Bracket(12.0, 12.5),
        "theta_s 40": Bracket(5.0, 5.5),
        "evagination": Bracket(10.0, 11.0),
    }
    found.asked = {"theta_b 40": [found.sets["slenderness"][0].row], "evagination": []}
    return found


def coexistence(settings):
    """Return slits down to R/h = 12 whose energy is the round cups' at R/h = 12.75."""
    pairs = []
    for t_n in SLITS["times"]:
        for ratio in settings["ratios"]:
            there = ratio >= 12
            excess = 1e-4 * (12.75 - ratio) if there and ratio < 14 else None
            pairs.append(
                {
                    "ratio": ratio,
                    "t_n": t_n,
                    "kappa_cap_R": ratio * (0.8 + t_n),
                    "slit_touches": ratio > 13.2 if there else None,
                    "energy_slit": 1.3 if there else None,
                    "energy_round": 1.3 / (1 + excess) if excess is not None else None,
                    "m2_slit": 0.1 * (ratio - 8) if there else None,
                    "slit_crosses_itself": False if there else None,
                    "excess": excess,
                }
            )
    return {"status": "ok", "reason": None, "row": {}, "pairs": pairs}


def plate(ratio):
    """Return a disc that obeys (S35)."""
    row = {"kappa_h": PLATE / ratio**2, "wavenumber": 2}
    return {"status": "ok", "reason": None, "row": row}
