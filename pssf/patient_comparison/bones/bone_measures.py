"""Measures of form of patient bones and sampled bones, in one frame and at one size."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.checks import Array
from ...geometry.mesh import Mesh
from .bone_registration import register_bone
from .frontal_measures import measure_front_view
from .shape_measures import measure_bones
from .surface_distance import SampledSurface

Row = dict[str, Any]


def measure_bone(surface: SampledSurface, model: SampledSurface, bone: str) -> dict[str, float]:
    """Measure the form of a bone after registration to a model by a similarity, which removes size and pose.

    Parameters
    ----------
    surface : SampledSurface
        Bone near its joint, see :func:`~pssf.patient_comparison.bones.bone_registration.crop_near_joint`.
    model : SampledSurface
        Model of the same kind of bone, near its joint.
    bone : {"femur", "tibia", "patella"}
        Kind of bone.

    Returns
    -------
    dict of str to float
        Measures of form by name.
    """
    fit, near = register_bone(surface, model, bone), surface.mesh
    laid = Mesh(fit.apply(near.vertices), near.faces)
    return measure_bones({bone: laid}) | measure_front_view(bone, laid)


def compare_bone_measures(
    bone: str, patient_values: Sequence[Mapping[str, float]], simulated_values: Sequence[Mapping[str, float]]
) -> list[Row]:
    """Compare the measures of form of patient bones with those of sampled bones.

    Parameters
    ----------
    bone : {"femur", "tibia", "patella"}
        Kind of bone.
    patient_values : sequence of mapping
        Measures of each patient bone, of two or more bones.
    simulated_values : sequence of mapping
        Measures of each sampled bone, of two or more bones.

    Returns
    -------
    list of dict
        One row per measure, with the columns of :func:`compare_samples`.
    """
    return [
        {"bone": bone, "measure": what}
        | compare_samples(*(np.array([one[what] for one in of]) for of in (patient_values, simulated_values)))
        for what in patient_values[0]
    ]


def compare_samples(patient_values: Array, simulated_values: Array) -> Row:
    """Compare mean and standard deviation of one measure between patients and simulated knees.

    Parameters
    ----------
    patient_values : (n,) array, any unit
        Values of two or more patients.
    simulated_values : (m,) array, any unit
        Values of two or more simulated knees.

    Returns
    -------
    dict
        Number, mean and standard deviation of patients (``given``, ``mean``, ``sd``) and of simulated knees
        (``drawn``, ``drawn_mean``, ``drawn_sd``). ``off_sd`` is the simulated mean minus the patient mean, divided by
        the standard deviation of patients. ``spread_ratio`` is the simulated standard deviation over that of patients.
    """
    mean, sd, drawn_mean, drawn_sd = (
        patient_values.mean(),
        patient_values.std(ddof=1),
        simulated_values.mean(),
        simulated_values.std(ddof=1),
    )
    return {
        "given": len(patient_values), "mean": float(mean), "sd": float(sd), "drawn": len(simulated_values),
        "drawn_mean": float(drawn_mean), "drawn_sd": float(drawn_sd), "off_sd": float((drawn_mean - mean) / sd),
        "spread_ratio": float(drawn_sd / sd),
    }  # fmt: skip
