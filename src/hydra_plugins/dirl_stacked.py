"""Hydra's launcher of jobs that are trained as one program: ``hydra/launcher=stacked``.

Hydra takes plug-ins from the package ``hydra_plugins`` only.
"""

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path

from hydra._internal.core_plugins.basic_launcher import BasicLauncher
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus, setup_globals
from omegaconf import open_dict, read_write


class StackedLauncher(BasicLauncher):
    """Composes all jobs, and gives them to the recipe together."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs; their folders are those that Hydra's own launcher would give them."""
        from dirl.training.together import Job  # late: Hydra imports every plug-in when it starts

        assert self.hydra_context is not None
        assert self.config is not None
        assert self.task_function is not None
        setup_globals()
        jobs, returns = [], []
        for number, overrides in enumerate(job_overrides, initial_job_idx):
            config = self.hydra_context.config_loader.load_sweep_config(self.config, list(overrides))
            with open_dict(config):
                config.hydra.job.id = config.hydra.job.num = number
            HydraConfig.instance().set_config(config)
            composed = deepcopy(config)
            with read_write(composed), open_dict(composed):
                del composed["hydra"]
            folder = Path(config.hydra.sweep.dir) / config.hydra.sweep.subdir
            jobs.append(Job(composed, folder, list(config.hydra.overrides.task)))
            returns.append(JobReturn(overrides=overrides, cfg=composed, hydra_cfg=config))
        for result, returned in zip(self.task_function(jobs), returns, strict=True):
            failed = isinstance(result, Exception)
            returned.status = JobStatus.FAILED if failed else JobStatus.COMPLETED
            returned.return_value = result if failed else result["greedy"]["spl"]
        return returns
