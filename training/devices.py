"""Many devices and hosts as one mesh, by JAX's own runtime.

Notation: D devices of P processes stand in one line, the mesh axis "rays". Rays and samples are split along it (each device
computes its share), pixels are stored along it, parameters and everything else are whole on every device. The programs are
ordinary `jit`s of the global batch: the compiler inserts the sums, so that what is computed does not depend on D, but for the
order in which floats are added.

Every process runs the same lines in the same order; process 0 alone writes files. Whatever a process decides by itself
(a signal, a clock, a file it cannot read) is agreed upon first, or the others would wait for it for ever.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from console import UserError

AXIS = "rays"
SPLIT, WHOLE = PartitionSpec(AXIS), PartitionSpec()
Tree = TypeVar("Tree")

# (processes, index) as launchers tell a process of itself
LAUNCHERS = (
    ("SLURM_STEP_NUM_TASKS", "SLURM_PROCID"),
    ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"),
    ("PMI_SIZE", "PMI_RANK"),
)


def launched() -> tuple[int, int] | None:
    """(processes, this one's index) as the launcher tells (Slurm, Open MPI and MPICH's environment), None without one."""
    return next(
        ((int(os.environ[n]), int(os.environ[i])) for n, i in LAUNCHERS if n in os.environ and i in os.environ), None
    )


def join_processes(coordinator: str | None = None, processes: int | None = None, process_id: int | None = None) -> None:
    """Connects this process with the others of its run; does nothing where it is the only one. Call before JAX is used.

    What is left out is taken from the launcher (Slurm, Open MPI and MPICH's environment; JAX itself knows Slurm, Open
    MPI 4, Kubernetes jobs and TPU pods). UserError where the options do not fit together, or the others do not come.
    """
    found = launched()
    address = coordinator or os.environ.get("JAX_COORDINATOR_ADDRESS")
    in_kubernetes_job = "KUBERNETES_SERVICE_HOST" in os.environ and "JOB_COMPLETION_INDEX" in os.environ
    is_alone = address is None and processes is None and process_id is None and (found is None or found[0] == 1)
    if is_alone and not in_kubernetes_job:
        return
    if address is not None and found is not None:
        processes = found[0] if processes is None else processes
        process_id = found[1] if process_id is None else process_id
    try:
        jax.distributed.initialize(address, processes, process_id)
    except (ValueError, TypeError, RuntimeError) as error:
        expected = "HOST:PORT of process 0, the number of processes, and the number of this one (from 0)"
        raise UserError("the processes of this run could not be joined", where="--coordinator, --processes, --process-id",
                        expected=expected, found=str(error).split("\n")[0][:160]) from error  # fmt: skip


@lru_cache
def every_device() -> Mesh:
    """All devices of all processes in one line; a process's own stand together."""
    devices = sorted(jax.devices(), key=lambda device: (device.process_index, device.id))
    return Mesh(np.array(devices), (AXIS,))


def is_writer() -> bool:
    """Whether this process writes the run's files."""
    return jax.process_index() == 0


def split(tree: Tree, mesh: Mesh) -> Tree:
    """Within a compiled program: arrays [N, ...] whose rows the devices shall compute, N / D each. No value changes."""
    return tree if mesh.size == 1 else jax.lax.with_sharding_constraint(tree, NamedSharding(mesh, SPLIT))


def put_whole(tree: Tree, mesh: Mesh) -> Tree:
    """Arrays, the same in every process, onto every device; plain Python numbers stay what they are."""
    sharding = NamedSharding(mesh, WHOLE)

    def put(value: Any) -> Any:
        if not isinstance(value, (jax.Array, np.ndarray, np.generic)):
            return value
        if isinstance(value, jax.Array) and value.sharding == sharding:
            return value
        if mesh.size == 1:  # with the sharding that a step returns, or the second step would compile again
            return jax.device_put(value, sharding)
        host = np.asarray(value)
        return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])

    return jax.tree.map(put, tree)


def own_rows(count: int, mesh: Mesh) -> tuple[int, int]:
    """Of `count` rows stored along the mesh, padded to a multiple of D: the first and one past the last of this process."""
    share = -(-count // mesh.size)
    mine = [i for i, device in enumerate(mesh.devices.flat) if device.process_index == jax.process_index()]
    return mine[0] * share, (mine[-1] + 1) * share


def put_split(own: np.ndarray, count: int, mesh: Mesh) -> jax.Array:
    """The array of which this process has its own_rows(count) as `own`; rows beyond count are padding."""
    if mesh.size == 1:
        return jax.device_put(own, NamedSharding(mesh, WHOLE))
    shape = (-(-count // mesh.size) * mesh.size, *own.shape[1:])
    return jax.make_array_from_process_local_data(NamedSharding(mesh, SPLIT), own, shape)


def here(tree: Tree) -> Tree:
    """This process's own copy, on one device, of arrays that every device has; others and plain values stay as they are."""

    def local(value: Any) -> Any:
        shared = isinstance(value, jax.Array) and len(value.sharding.device_set) > 1
        return value.addressable_data(0) if shared and value.is_fully_replicated else value

    return jax.tree.map(local, tree)


def agree(tree: Tree) -> Tree:
    """Process 0's arrays, in every process. Their shapes must be the same in all."""
    if jax.process_count() == 1:
        return tree
    from jax.experimental import multihost_utils

    return jax.tree.map(np.asarray, multihost_utils.broadcast_one_to_all(tree))  # type: ignore[return-value]


def anywhere(flag: bool) -> bool:
    """Whether any process says so."""
    if jax.process_count() == 1:
        return flag
    from jax.experimental import multihost_utils

    return bool(np.asarray(multihost_utils.process_allgather(np.array([flag]))).any())


@contextmanager
def together() -> Iterator[None]:
    """What one process may fail at: where one raises, all do, instead of waiting for it."""
    failure: Exception | None = None
    try:
        yield
    except UserError as error:
        failure = error
    if jax.process_count() > 1 and anywhere(failure is not None) and failure is None:
        failure = UserError("another process of this run stopped", remedy="see the message of that process")
    if failure is not None:
        raise failure
