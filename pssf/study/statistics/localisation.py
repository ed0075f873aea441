"""How far the found joint line is from the known one, and how often it was not found."""

import numpy as np
import pandas as pd

GROSS_MM = 5.0  # about a whole joint space: the region is then of another place


def errors(table: pd.DataFrame) -> pd.DataFrame:
    """The table with error_px and error_mm: distance of found from known, in the image and at the joint plane.

    table  found row_px, col_px; known truth_medial_row_px, truth_medial_col_px; pixel_mm, sdd_mm, sod_mm
    """
    rows = table["row_px"] - table["truth_medial_row_px"]
    cols = table["col_px"] - table["truth_medial_col_px"]
    error_px = np.hypot(rows, cols)
    magnification = table["sdd_mm"] / table["sod_mm"]
    per_px_mm = table["pixel_mm"] / magnification
    return table.assign(
        error_px=error_px, error_mm=error_px * per_px_mm, error_row_mm=rows * per_px_mm, error_col_mm=cols * per_px_mm
    )


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """One row a protocol and grade, and one for all.

    table    of `errors`, with protocol, grade, score, status
    returns  radiographs; refused (by cause); and of the accepted ones: mean and 95th percentile of the error, its mean
             along rows and columns, how many are off by more than 5 mm, and the lowest score
    """
    rows = [
        {"protocol": protocol, "grade": str(grade), **_row(part)}
        for protocol, of_protocol in table.groupby("protocol", sort=False)
        for grade, part in of_protocol.groupby("grade")
    ]
    return pd.DataFrame([*rows, {"protocol": "all", "grade": "all", **_row(table)}])


def _row(part: pd.DataFrame) -> dict[str, float]:
    accepted = part[part["status"] == "found"]
    return {
        "radiographs": len(part),
        "refused": int((~part["status"].isin(["found", "leaves image"])).sum()),
        "leaves_image": int((part["status"] == "leaves image").sum()),
        "mean_px": accepted["error_px"].mean(),
        "p95_px": accepted["error_px"].quantile(0.95),
        "mean_mm": accepted["error_mm"].mean(),
        "p95_mm": accepted["error_mm"].quantile(0.95),
        "row_bias_mm": accepted["error_row_mm"].mean(),
        "col_bias_mm": accepted["error_col_mm"].mean(),
        "gross": int((accepted["error_mm"] > GROSS_MM).sum()),
        "lowest_score": part["score"].min(),
    }
