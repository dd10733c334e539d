"""What a calibration by a local dask cluster takes: time and memory of client and workers.

    python benchmarks/scale.py [--actuators 132] [--files 4] [--workers 2]

A campaign of FORCE and POSITION is simulated and written into a temporary folder. A client and its
workers, in processes of their own, read and calibrate it. Printed are processor seconds, and the
peak of memory above that before the calibration; and how far alpha is from that without a cluster.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from distributed import Client, LocalCluster

import truenewton as tn
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.mirrors.known import ring


def used() -> tuple[float, float]:
    """Return processor time [s] and peak of memory [MB] of this process."""
    import truenewton.calibration.methods
    import truenewton.reading  # noqa: F401 - imported before the first figure is taken

    status = Path("/proc/self/status").read_text(encoding="ascii")  # Linux
    return time.process_time(), 1.024e-3 * int(status.partition("VmHWM:")[2].split()[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--actuators", type=int, default=132)
    parser.add_argument("--files", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        bench = static_bench(ring(asked.actuators), 1)
        tn.write_campaign(run_cycles(bench, asked.files // 2), folder)
        size = sum(path.stat().st_size for path in folder.iterdir()) / 1e6
        with (
            LocalCluster(
                n_workers=asked.workers, threads_per_worker=1, dashboard_address=":0"
            ) as cluster,
            Client(cluster) as client,
        ):
            before, workers_before = used(), client.run(used)
            found = tn.calibrate(tn.read_campaign(folder, client=client), client=client)
            after, workers_after = used(), client.run(used)
        alone = tn.calibrate(tn.read_campaign(folder))
    took = {name: np.subtract(workers_after[name], workers_before[name]) for name in workers_before}
    seconds, memory = np.array(list(took.values())).T
    off = np.nanmax(np.abs(found.alpha - alone.alpha) / alone.error)
    print(
        f"{asked.actuators} actuators, {asked.files} files, {size:.1f} MB, {asked.workers} workers"
    )
    print(f"client   {after[0] - before[0]:7.2f} s {after[1] - before[1]:7.0f} MB")
    print(f"workers  {seconds.sum():7.2f} s {memory.max():7.0f} MB, the largest")
    print(f"alpha differs by at most {off:.1g} of E_ALPHA from that without a cluster")


if __name__ == "__main__":
    main()
