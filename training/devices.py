"""Many devices and hosts as one mesh, by JAX's own runtime.

Notation: D devices of P processes stand in one line, the mesh axis "rays". Rays, samples and pixels are split along it,
parameters and everything else are whole on every device. Programs are `jit`s of the global batch into which the compiler
inserts the sums: D changes nothing but the order in which floats are added.

Every process runs the same lines in the same order; process 0 alone writes files. The processes agree upon what one of them
decides (by a signal, a clock, a file that it cannot read), or the others would wait for it for ever.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from console import UserError

AXIS = "rays"
SPLIT, WHOLE = PartitionSpec(AXIS), PartitionSpec()
Tree = TypeVar("Tree")

# Variables of the number of processes and the index of this one
LAUNCHERS = (
    ("SLURM_STEP_NUM_TASKS", "SLURM_PROCID"),
    ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"),
    ("PMI_SIZE", "PMI_RANK"),
)


def launched() -> tuple[int, int] | None:
    """(processes, index of this one) by the launcher's variables; None without a launcher."""
    values = ([os.environ.get(name, "") for name in names] for names in LAUNCHERS)
    return next(((int(count), int(index)) for count, index in values if count.isdecimal() and index.isdecimal()), None)


def join_processes(coordinator: str | None = None, processes: int | None = None, process_id: int | None = None) -> None:
    """Connects this process with the others of its run; does nothing where it is the only one. Call before JAX is used.

    What is left out comes from the launcher (Slurm, Open MPI, MPICH; JAX itself knows Slurm, Open MPI 4, Kubernetes jobs and TPU
    pods). UserError where the options do not fit together, or the others do not connect.
    """
    found = launched()
    address = coordinator or os.environ.get("JAX_COORDINATOR_ADDRESS")
    in_kubernetes_job = {"KUBERNETES_SERVICE_HOST", "JOB_COMPLETION_INDEX"} <= os.environ.keys()
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
    """Within a compiled program: the same arrays [N, ...], of which each device computes N / D rows."""
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
    return multihost_utils.broadcast_one_to_all(tree)


def anywhere(flag: bool) -> bool:
    """Whether any process says so."""
    return bool(multihost_utils.process_allgather(np.array([flag])).any())


@contextmanager
def together() -> Iterator[None]:
    """Where the block raises a UserError in one process, it does in all, instead of waiting for that one."""
    failure: Exception | None = None
    try:
        yield
    except UserError as error:
        failure = error
    if anywhere(failure is not None) and failure is None:
        failure = UserError("another process of this run stopped", remedy="see the message of that process")
    if failure is not None:
        raise failure
