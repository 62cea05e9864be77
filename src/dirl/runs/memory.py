"""How much memory a process has needed."""

import sys
from pathlib import Path


def peak_memory_mb() -> float | None:
    """Return the most memory this process has held, MB; None where the system does not say, as on Windows."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux `getrusage` would include the memory of the parent before the fork
        return int(status.read_text().split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    try:
        import resource
    except ImportError:  # on Windows
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
