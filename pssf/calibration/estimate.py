"""Define an estimated value with its confidence interval."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..core.checks import Array

# Half width of the confidence interval, in standard errors; 95 % of a normal distribution.
Z_95 = 1.96


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Value of a detector or beam parameter.

    Attributes
    ----------
    value : float
        Estimated or assumed value.
    low, high : float
        95 % confidence interval; equal to `value` if the value is assumed.
    source : {"measured", "held"}
        Whether the value was measured, or held at the value of the starting detector or protocol.
    note : str
        Reason why a value is held, or condition of the measurement.
    """

    value: float
    low: float
    high: float
    source: str = "measured"
    note: str = ""

    @property
    def relative_error(self) -> float:
        """Standard error of a positive value divided by the value."""
        return float(np.log(self.high / self.low)) / (2 * Z_95)

    def scale(self, factor: float) -> "Estimate":
        """Multiply the value and its interval by a number.

        Parameters
        ----------
        factor : float
            Positive factor.

        Returns
        -------
        Estimate
            Scaled estimate.
        """
        return Estimate(
            value=self.value * factor,
            low=self.low * factor,
            high=self.high * factor,
            source=self.source,
            note=self.note,
        )


def make_estimate(value: float, standard_error: float, *, is_positive: bool = True, note: str = "") -> Estimate:
    """Make a measured value with its 95 % confidence interval.

    Parameters
    ----------
    value : float
        Estimated value.
    standard_error : float
        Standard error, in the unit of the value.
    is_positive : bool, default True
        Whether the parameter is positive, so that the interval is symmetric on a logarithmic scale.
    note : str, default ""
        Condition of the measurement.

    Returns
    -------
    Estimate
        Value with interval.
    """
    if is_positive and value > 0:
        factor = float(np.exp(Z_95 * standard_error / value))
        return Estimate(value=value, low=value / factor, high=value * factor, note=note)
    return Estimate(value=value, low=value - Z_95 * standard_error, high=value + Z_95 * standard_error, note=note)


def hold_value(value: float, note: str) -> Estimate:
    """Make a value that is assumed and not measured.

    Parameters
    ----------
    value : float
        Assumed value.
    note : str
        Reason.

    Returns
    -------
    Estimate
        Value without interval.
    """
    return Estimate(value=value, low=value, high=value, source="held", note=note)


def make_estimate_rows(estimates: Mapping[str, Estimate]) -> list[dict[str, str]]:
    """Make a table of estimates.

    Parameters
    ----------
    estimates : mapping of str to Estimate
        Estimates by name.

    Returns
    -------
    list of dict
        One row per value, with its 95 % interval, which is empty for a held value.
    """
    return [
        {
            "name": name,
            "value": f"{one.value:.6g}",
            "low": f"{one.low:.6g}" if one.source == "measured" else "",
            "high": f"{one.high:.6g}" if one.source == "measured" else "",
            "source": one.source,
            "note": one.note,
        }
        for name, one in estimates.items()
    ]


def compute_covariance(jacobian: Array) -> Array:
    """Compute the covariance of parameters from the Jacobian matrix of residuals with a variance of 1.

    Parameters
    ----------
    jacobian : (residuals, parameters) array, any unit
        Derivative of each residual with respect to each parameter.

    Returns
    -------
    (parameters, parameters) float64 array
        Covariance matrix, in the squared units of the parameters; infinite variances if the matrix is singular.
    """
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    if singular[-1] <= singular[0] * 1e-12:
        return np.diag(np.full(jacobian.shape[1], np.inf))
    return np.asarray((rows.T / singular**2) @ rows)
