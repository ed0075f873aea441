"""Settings for the training of the reader."""

from dataclasses import dataclass

from ..core.checks import require_choice, require_in_range, require_integer

RECIPES = ("none", "mild", "strong")


@dataclass(frozen=True, kw_only=True)
class ReaderTrainingSettings:
    """Settings for the training of the networks of the reader.

    Parameters
    ----------
    images : int, default 4000
        Number of simulated radiographs, 20 or more.
    seed : int, default 0
        Seed of all random numbers.
    landmark_steps : int, default 6000
        Number of training steps of the network that finds landmarks and masks.
    locator_steps : int, default 3000
        Number of training steps of the network that finds knees.
    side_steps : int, default 4200
        Number of training steps of the network that tells right from left knees.
    batch : int, default 8
        Number of images per step.
    learning_rate : float, default 0.004
        Largest learning rate.
    crop_px : int, default 192
        Side of the input of the landmark network, in pixels; a multiple of 32.
    plateau_px : float, default 112.0
        Mean width of the tibial plateau in the input of the landmark network, in pixels.
    width : int, default 20
        Number of feature maps at the highest resolution.
    randomisation : {"none", "mild", "strong"}, default "strong"
        Recipe for the random change of grey values.
    deformation_sd : float, default 0.02
        Standard deviation of random displacements of the image, as a fraction of the plateau width.
    threads : int, default 2
        Number of threads of PyTorch. The number changes the order of sums, and so the last digits of the networks.
    """

    images: int = 4000
    seed: int = 0
    landmark_steps: int = 6000
    locator_steps: int = 3000
    side_steps: int = 4200
    batch: int = 8
    learning_rate: float = 4e-3
    crop_px: int = 192
    plateau_px: float = 112.0
    width: int = 20
    randomisation: str = "strong"
    deformation_sd: float = 0.02
    threads: int = 2

    def __post_init__(self) -> None:
        require_integer("images", self.images, 20, 10_000_000, "")
        require_integer("seed", self.seed, 0, 2**63 - 1, "")
        for name in ("landmark_steps", "locator_steps", "side_steps"):
            require_integer(name, getattr(self, name), 1, 10_000_000, "")
        require_integer("batch", self.batch, 2, 1024, "")
        require_in_range("learning_rate", self.learning_rate, 1e-6, 1.0, "")
        require_integer("crop_px", self.crop_px, 64, 1024, "pixels")
        require_in_range("plateau_px", self.plateau_px, 20.0, float(self.crop_px), "pixels")
        require_integer("width", self.width, 4, 256, "")
        require_in_range("deformation_sd", self.deformation_sd, 0.0, 0.1, "plateau widths")
        require_integer("threads", self.threads, 1, 1024, "")
        require_choice("randomisation", self.randomisation, RECIPES)


@dataclass(frozen=True, kw_only=True)
class FineTuningSettings:
    """Settings for the training of the landmark network on annotated radiographs.

    Parameters
    ----------
    seed : int, default 0
        Seed of all random numbers.
    steps : int, default 600
        Number of training steps.
    batch : int, default 8
        Number of knees per step.
    learning_rate : float, default 0.0005
        Largest learning rate.
    randomisation : {"none", "mild", "strong"}, default "mild"
        Recipe for the random change of grey values.
    threads : int, default 2
        Number of threads of PyTorch.
    """

    seed: int = 0
    steps: int = 600
    batch: int = 8
    learning_rate: float = 5e-4
    randomisation: str = "mild"
    threads: int = 2

    def __post_init__(self) -> None:
        require_integer("seed", self.seed, 0, 2**63 - 1, "")
        require_integer("steps", self.steps, 1, 10_000_000, "")
        require_integer("batch", self.batch, 2, 1024, "")
        require_in_range("learning_rate", self.learning_rate, 1e-6, 1.0, "")
        require_choice("randomisation", self.randomisation, RECIPES)
        require_integer("threads", self.threads, 1, 1024, "")
