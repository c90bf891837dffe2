"""A SLURM cluster of this machine alone, without privileges: for tests where SLURM's programs are installed."""

from __future__ import annotations

import contextlib
import getpass
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from helpers.ports import free_port

SEARCHED = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])
CONTROLLER, NODE = (shutil.which(name, path=SEARCHED) for name in ("slurmctld", "slurmd"))
CONFIGURATION = """
ClusterName=local
SlurmctldHost=localhost
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
KillWait=2
ReturnToService=2
NodeName=localhost CPUs={cores} RealMemory=8192 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[dict[str, str]]:
    """The environment in which SLURM's commands reach the cluster, which ends with its jobs when the block does."""
    for name in ("state", "spool"):
        (folder / name).mkdir(parents=True)
    configuration = folder / "slurm.conf"
    settings = {"user": getpass.getuser(), "ports": [free_port(), free_port()], "cores": os.cpu_count()}
    configuration.write_text(CONFIGURATION.format(folder=folder, **settings))
    environment = os.environ | {"SLURM_CONF": str(configuration)}
    with contextlib.ExitStack() as ended:
        for program in ([CONTROLLER, "-D"], [NODE, "-D", "-N", "localhost"]):
            process = subprocess.Popen(program, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            ended.callback(process.wait, 30)
            ended.callback(process.terminate)
        ready = ["sinfo", "--noheader", "--format=%T"]
        until(lambda: slurm(ready, environment, check=False).strip() == "idle", "the node is ready", seconds=60)
        ended.callback(slurm, ["scancel", "--full", "--user", settings["user"]], environment)
        yield environment


def slurm(command: list[str], environment: dict[str, str], check: bool = True, **options: str) -> str:
    """What a command of SLURM prints."""
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=check, **options).stdout


def until(reached: Callable[[], bool], what: str, seconds: float = 300) -> None:
    """Wait for something. Raises TimeoutError that says what it was."""
    end = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds:g} s: {what}")
        time.sleep(0.1)
