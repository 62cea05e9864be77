"""Installed packages, built-in scenes, and the versions that a bug report needs."""

import importlib.metadata
import os
import platform

import torch

from dirl.scenes import PUBLISHED_GOALS, load_scenes

PACKAGES = ("dirl", "torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "numpy", "h5py", "wandb")


def tell() -> None:
    """Print it."""
    print(f"Python {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores")
    for package in PACKAGES:
        try:
            print(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            print(f"{package} is not installed")
    cuda = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    print(f"\ndevice=cpu: {torch.get_num_threads()} threads\ndevice=cuda: {cuda}")
    print("\nbuilt-in scenes (source: rooms, synthetic):")
    for scene in load_scenes(list(PUBLISHED_GOALS)):
        print(f"  {scene.name}: {len(scene)} states, goals {', '.join(map(str, scene.goals))}")
