"""Hydra's launcher of jobs that are trained as one program: ``hydra/launcher=stacked``.

Hydra takes plug-ins from the package ``hydra_plugins`` only.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_launcher import BasicLauncher
from hydra.core.utils import JobReturn, JobStatus


class StackedLauncher(BasicLauncher):
    """Composes all jobs as Hydra's own launcher does, and then gives them to the recipe together."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs."""
        from dirl.training.stacked import Job  # late: Hydra imports every plug-in when it starts

        assert self.task_function is not None
        train, self.task_function = self.task_function, lambda composed: None
        returns: Sequence[Any] = super().launch(job_overrides, initial_job_idx)
        jobs = [Job(job.cfg, Path(job.hydra_cfg.hydra.runtime.output_dir), job.overrides) for job in returns]
        for result, returned in zip(train(jobs), returns, strict=True):
            failed = isinstance(result, Exception)
            returned.status = JobStatus.FAILED if failed else JobStatus.COMPLETED
            returned.return_value = result if failed else result["greedy"]["spl"]
        return returns
