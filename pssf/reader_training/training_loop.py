"""Train a network step by step, with checkpoints from which a stopped training continues with the same numbers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

# Number of steps over which the learning rate rises to its largest value.
_WARM_UP_STEPS = 50
# Number of steps between checkpoints.
_CHECKPOINT_STEPS = 200
_WEIGHT_DECAY = 1e-3
_MAX_GRADIENT = 1.0

ComputeLoss = Callable[[nn.Module, np.random.Generator], Tensor]
Report = Callable[[int, int, float], None]


def train_network(
    network: nn.Module,
    compute_loss: ComputeLoss,
    *,
    steps: int,
    learning_rate: float,
    seed: int,
    checkpoint: Path,
    report: Report,
) -> None:
    """Train a network with AdamW and a cosine schedule of the learning rate.

    The random numbers of each step depend only on `seed` and the number of the step.

    Parameters
    ----------
    network : torch.nn.Module
        Network; it is changed in place.
    compute_loss : callable
        Function of the network and a random generator that makes a batch and returns its loss. It may also use the
        global generator of PyTorch.
    steps : int
        Number of steps.
    learning_rate : float
        Largest learning rate.
    seed : int
        Seed of all random numbers.
    checkpoint : Path
        File in which the state is kept, and from which an interrupted training continues.
    report : callable
        Function of the finished steps, all steps and the mean loss since the last call.
    """
    optimiser = torch.optim.AdamW(network.parameters(), lr=learning_rate, weight_decay=_WEIGHT_DECAY)
    first = _load_checkpoint(checkpoint, network, optimiser)
    losses: list[float] = []
    network.train()
    for step in range(first, steps):
        streams = np.random.SeedSequence(seed, spawn_key=(step,)).spawn(2)
        torch.manual_seed(int(streams[0].generate_state(1)[0]))
        for group in optimiser.param_groups:
            group["lr"] = learning_rate * _schedule(step, steps)
        loss = compute_loss(network, np.random.default_rng(streams[1]))
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), _MAX_GRADIENT)
        optimiser.step()
        losses.append(loss.item())
        if (step + 1) % _CHECKPOINT_STEPS == 0 or step + 1 == steps:
            _save_checkpoint(checkpoint, network, optimiser, step + 1)
            report(step + 1, steps, float(np.mean(losses)))
            losses.clear()
    network.eval()


def _schedule(step: int, steps: int) -> float:
    """Return the learning rate of a step as a fraction of the largest one."""
    return min(1.0, (step + 1) / _WARM_UP_STEPS) * 0.5 * (1 + float(np.cos(np.pi * step / steps)))


def _save_checkpoint(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer, step: int) -> None:
    """Replace the checkpoint at once, so that an interruption leaves the old or the new one."""
    part = path.with_suffix(".part")
    torch.save({"step": step, "network": network.state_dict(), "optimiser": optimiser.state_dict()}, part)
    part.replace(path)


def _load_checkpoint(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> int:
    """Load the state of a stopped training, and return the number of finished steps."""
    if not path.exists():
        return 0
    state = torch.load(path, weights_only=True)
    network.load_state_dict(state["network"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["step"])
