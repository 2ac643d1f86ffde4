"""The peer of phase 2: an LSTM on sliding windows in PyTorch, nothing of ours in it."""

import time
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

WINDOW, HIDDEN, BATCH, LEARNING_RATE, EPOCHS, PATIENCE = 50, 32, 128, 3e-3, 100, 10
TRIALS = 5
TORCH = "PyTorch, sliding windows"


@dataclass(frozen=True)
class MeasuredTests:
    """Measured of one direction and what a benchmark gives for them, arrays of shape [T, N].

    Attributes:
        command: effective command.
        benchmark: displacement the benchmark gives, mm.
        displacement: measured, mm.
        step_s: sampling time, s.
    """

    command: np.ndarray
    benchmark: np.ndarray
    displacement: np.ndarray
    step_s: float

    @property
    def error(self) -> np.ndarray:
        """What the benchmark misses, mm."""
        return self.displacement - self.benchmark

    def features(self) -> np.ndarray:
        """Return the ten features of Sun et al. 2025, sec. 2.2.3, at every sample, shape [T, N, 10]."""

        def delayed(rows: np.ndarray, samples: int = 1) -> np.ndarray:
            return np.pad(rows, ((0, 0), (samples, 0)))[:, : rows.shape[1]]

        def change(rows: np.ndarray) -> np.ndarray:
            return np.diff(rows, axis=1, prepend=rows[:, :1])

        error = self.error
        columns = [
            np.broadcast_to(self.step_s * np.arange(error.shape[1]), error.shape),
            self.command,
            change(self.command),
            self.benchmark,
            change(self.benchmark),
            self.displacement,
            change(self.displacement) / self.step_s,
            delayed(error),
            delayed(error) - delayed(error, 2),
            self.step_s * np.cumsum(error, axis=1),
        ]
        return np.stack(columns, axis=-1)


class Network(nn.Module):
    """An LSTM and a linear layer on its last output."""

    def __init__(self) -> None:
        super().__init__()
        self.lstm = nn.LSTM(10, HIDDEN, batch_first=True)
        self.head = nn.Linear(HIDDEN, 1)

    def forward(self, windows: Tensor) -> Tensor:
        """Return one number for each window of shape [B, 50, 10]."""
        outputs, _ = self.lstm(windows)
        return self.head(outputs[:, -1])[:, 0]


def windows_of(features: np.ndarray) -> Tensor:
    """Return the 50 features before every sample but the first, zeros before a test: [T (N − 1), 50, 10]."""
    padded = np.pad(features[:, :-1], ((0, 0), (WINDOW - 1, 0), (0, 0))).astype(np.float32)
    windows = torch.from_numpy(padded).unfold(1, WINDOW, 1)
    return windows.permute(0, 1, 3, 2).reshape(-1, WINDOW, features.shape[2])


def train(
    training: MeasuredTests, validation: MeasuredTests, seed: int, epochs: int = EPOCHS, threads: int = 2
) -> list[tuple[float, np.ndarray]]:
    """Train with Adam and early stopping.

    The target is the step the error takes to the next sample, in its spread: far easier than the error.

    Args:
        training, validation: tests.
        seed: of weights and shuffling.
        epochs: largest number of passes.
        threads: of PyTorch's.

    Returns:
        After each epoch the seconds since the start and the errors predicted for the validation tests, mm,
        shape [V, N − 1].
    """
    started = time.perf_counter()
    torch.set_num_threads(threads)
    torch.manual_seed(seed)
    training_features, validation_features = training.features(), validation.features()
    centre, spread = training_features.mean(axis=(0, 1)), training_features.std(axis=(0, 1))
    inputs, validation_inputs = (
        windows_of((features - centre) / spread) for features in (training_features, validation_features)
    )
    error_steps = np.diff(training.error, axis=1)
    step = error_steps.std()
    target = torch.from_numpy((error_steps / step).reshape(-1).astype(np.float32))
    network = Network()
    optimiser = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    previous_errors, history = validation.error[:, :-1], []
    best, stale_epochs = np.inf, 0
    for _ in range(epochs):
        _epoch(network, optimiser, inputs, target)
        with torch.no_grad():
            steps = network(validation_inputs).numpy().reshape(previous_errors.shape)
        history.append((time.perf_counter() - started, previous_errors + step * steps))
        loss = float(np.mean((history[-1][1] - validation.error[:, 1:]) ** 2))
        best, stale_epochs = (loss, 0) if loss < best else (best, stale_epochs + 1)
        if stale_epochs >= PATIENCE:
            break
    return history


def fastest_threads(training: MeasuredTests) -> int:
    """Return the number of threads, one or two, that trains on one test sooner, in the median of some trials.

    Where another program runs beside it, two threads wait for each other, often longer than they save.
    """

    def epoch_seconds(threads: int) -> float:
        torch.set_num_threads(threads)
        started = time.perf_counter()
        _epoch(network, optimiser, inputs, target)
        return time.perf_counter() - started

    inputs = windows_of(training.features()[:1])
    target, network = torch.zeros(len(inputs)), Network()
    optimiser = torch.optim.Adam(network.parameters())
    _epoch(network, optimiser, inputs, target)
    trials = np.array([[epoch_seconds(threads) for threads in (1, 2)] for _ in range(TRIALS)])
    return 1 + int(np.argmin(np.median(trials, axis=0)))


def _epoch(network: Network, optimiser: torch.optim.Optimizer, inputs: Tensor, target: Tensor) -> None:
    """Pass once over the windows in random order."""
    for rows in torch.randperm(len(target)).split(BATCH):
        optimiser.zero_grad()
        nn.functional.mse_loss(network(inputs[rows]), target[rows]).backward()
        optimiser.step()
