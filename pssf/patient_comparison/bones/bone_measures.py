"""Compute shape measures of patient and sampled bones in a common frame and at a common size."""

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
    """Compute shape measures of a bone after similarity registration to a model bone, which removes size and pose.

    Parameters
    ----------
    surface : SampledSurface
        Joint end of the bone, from :func:`~pssf.patient_comparison.bones.bone_registration.crop_near_joint`.
    model : SampledSurface
        Joint end of a model bone of the same type.
    bone : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    dict of str to float
        Shape measures keyed by measure name.
    """
    fit, near = register_bone(surface, model, bone), surface.mesh
    laid = Mesh(fit.apply(near.vertices), near.faces)
    return measure_bones({bone: laid}) | measure_front_view(bone, laid)


def compare_bone_measures(
    bone: str, patient_values: Sequence[Mapping[str, float]], simulated_values: Sequence[Mapping[str, float]]
) -> list[Row]:
    """Compare the shape measures of patient bones with those of sampled bones.

    Parameters
    ----------
    bone : {"femur", "tibia", "patella"}
        Bone type.
    patient_values : sequence of mapping
        Shape measures of each patient bone; at least two bones.
    simulated_values : sequence of mapping
        Shape measures of each sampled bone; at least two bones.

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
    """Compare the mean and standard deviation of a measure between patients and simulated knees.

    Parameters
    ----------
    patient_values : (n,) array, any unit
        Values of the measure for two or more patients.
    simulated_values : (m,) array, any unit
        Values of the measure for two or more simulated knees.

    Returns
    -------
    dict
        Number, mean and standard deviation of patients (``patients``, ``patient_mean``, ``patient_sd``) and of
        simulated knees (``simulated``, ``simulated_mean``, ``simulated_sd``). ``difference_sd`` is the simulated mean
        minus the patient mean, divided by the standard deviation of patients. ``sd_ratio`` is the standard
        deviation of simulated knees divided by that of patients.
    """
    mean, sd, simulated_mean, simulated_sd = (
        patient_values.mean(),
        patient_values.std(ddof=1),
        simulated_values.mean(),
        simulated_values.std(ddof=1),
    )
    return {
        "patients": len(patient_values), "patient_mean": float(mean), "patient_sd": float(sd),
        "simulated": len(simulated_values), "simulated_mean": float(simulated_mean),
        "simulated_sd": float(simulated_sd), "difference_sd": float((simulated_mean - mean) / sd),
        "sd_ratio": float(simulated_sd / sd),
    }  # fmt: skip
