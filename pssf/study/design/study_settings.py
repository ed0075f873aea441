"""Study settings: regions, features, models and statistics."""

from dataclasses import dataclass, field

from ...core.checks import (
    InputError,
    require_choice,
    require_in_range,
    require_integer,
    require_seed,
)
from ...radiomics.features.feature_backends import default_backend, require_backend
from ...radiomics.features.feature_families import ALL_FAMILIES, AREAS, FAMILIES, SQUARE
from ...radiomics.localisation.region_placement import REGIONS

# Label of each feature selection and classifier in reports, keyed by its name in settings and tables.
SELECTIONS = {"l1": "L1", "mrmr": "mRMR"}
MODELS = {"lr": "Logistic regression", "rf": "Random forest", "xgb": "XGBoost"}


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """All settings that affect the results of a study, except cohort settings.

    Parameters
    ----------
    region_px : int
        Side length of the region at the medial joint line, 16 to 4096 px.
    bins : int
        Number of grey-level bins of the texture features, 8 to 256.
    repeats : int
        Number of random splits of the subjects, 1 to 1000.
    seed : int
        Seed of splits, models and bootstraps, 0 to 2**63 - 1.
    rho : float
        Threshold of absolute Spearman correlation, 0.1 to 1; above it, one of two features is pruned
        (`learn.models.feature_selection.DropRedundant`).
    most_features : int
        Maximum number of selected features, 1 to 100.
    replicates : int
        Number of bootstrap samples of subjects for trends, ICCs and patient radiographs, 100 to 100000.
    families : tuple of str
        Feature families to measure; other families are not computed.
    selections : tuple of str
        Feature selections, from `SELECTIONS`.
    models : tuple of str
        Classifiers, from `MODELS`.
    difference : float
        AUC difference for which the power is computed, 0.001 to 0.5.
    strengths : tuple of float
        Strengths of the association between a confounder and the grade, 0 to 0.95. Strength 0 is required as the
        reference for the other strengths.
    reference : str
        Reference protocol of the within-protocol scenario and of the pairwise ICCs.
    backend : str
        Radiomics backend, from `radiomics.features.feature_backends.BACKENDS`.
    regions : {"template", "reader", "truth"}
        Source of the position of the regions on simulated radiographs: search with templates, landmarks of `pssf.read`,
        or true labels. On patient radiographs, "truth" means "reader".
    areas : tuple of str
        Areas to measure, from `radiomics.features.feature_families.AREAS`: the square around the medial joint line, and
        regions of the tibia, which follow from landmarks and need `regions` "reader" or "truth". The pixels must be at
        most 0.2 mm for the families of `texture.TEXTURE_FAMILIES`.

    Raises
    ------
    InputError
        A value is out of range or unknown, a list contains a value twice, or regions of the tibia have no landmarks.
    """

    region_px: int = 512
    bins: int = 64
    repeats: int = 10
    seed: int = 0
    rho: float = 0.9
    most_features: int = 10
    replicates: int = 2000
    families: tuple[str, ...] = FAMILIES
    selections: tuple[str, ...] = tuple(SELECTIONS)
    models: tuple[str, ...] = tuple(MODELS)
    difference: float = 0.05
    strengths: tuple[float, ...] = (0.0, 0.3, 0.6, 0.9)
    reference: str = "reference"
    backend: str = field(default_factory=default_backend)
    regions: str = "template"
    areas: tuple[str, ...] = (SQUARE,)

    def __post_init__(self) -> None:
        require_integer("region_px", self.region_px, 16, 4096, "pixels")
        require_integer("bins", self.bins, 8, 256, "grey values")
        require_integer("repeats", self.repeats, 1, 1000, "splits")
        require_seed(self.seed)
        require_backend(self.backend)
        require_choice("regions", self.regions, REGIONS)
        require_in_range("rho", self.rho, 0.1, 1, "(correlation)")
        require_integer("most_features", self.most_features, 1, 100, "features")
        require_integer("replicates", self.replicates, 100, 100_000, "samples")
        require_in_range("difference", self.difference, 0.001, 0.5, "(of AUC)")
        for strength in self.strengths:
            require_in_range("strengths", strength, 0, 0.95, "(of the association)")
        if 0 not in self.strengths or len(set(self.strengths)) < len(self.strengths):
            raise InputError(
                f"strengths must include 0, and each value once, got {', '.join(map(str, self.strengths)) or 'none'}"
            )
        for name, allowed in (
            ("families", ALL_FAMILIES),
            ("areas", AREAS),
            ("selections", SELECTIONS),
            ("models", MODELS),
        ):
            given = getattr(self, name)
            if not given:
                raise InputError(f"{name} must contain at least one of {', '.join(allowed)}, got none")
            for choice in given:
                require_choice(name, choice, tuple(allowed))
            if len(set(given)) < len(given):
                raise InputError(f"{name} must list each entry once, got {', '.join(given)}")
        if self.regions == "template" and set(self.areas) != {SQUARE}:
            raise InputError(f"areas must be {SQUARE} if regions is template, got {', '.join(self.areas)}")

    @property
    def film_regions(self) -> str:
        """Source of the position of the regions on displayed and patient radiographs: "template" or "reader"."""
        return "template" if self.regions == "template" else "reader"
