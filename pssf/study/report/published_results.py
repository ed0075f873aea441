"""Published results of Alzubaidi and Al-Bayaty, arXiv 2601.11642; the report prints them for comparison only."""

PAPER_RESULTS = {"stable": 43, "features": 107, "within": 0.92, "cross": 0.78, "multi": "0.88–0.90"}
