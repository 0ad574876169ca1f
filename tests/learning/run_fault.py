"""Train the toy policy in a process that kills itself: run_fault.py RUN_DIR PLACE CALL."""

import os
import signal
import sys
from pathlib import Path

import torch
from toy_env import ToyEnv
from toy_run import make_toy_trainer

from maniskill_grpd.learning import checkpoint, run_log, trainer


def die():
    """End as an out-of-memory killer or a power cut would."""
    os.kill(os.getpid(), signal.SIGKILL)


def kill_at(owner, name, call, when="before"):
    """Replace a function by one that dies at the given call of it."""
    function, count = getattr(owner, name), 0

    def mortal(*args, **kwargs):
        nonlocal count
        count += 1
        if count == call and when == "before":
            die()
        result = function(*args, **kwargs)
        if count == call:
            die()
        return result

    setattr(owner, name, mortal)


def kill_in_last_checkpoint(call, when):
    """Die while last.pt is written: with half of it, before or after it is put in its place."""
    write, count = checkpoint._write_atomically, 0

    def mortal(path, data):
        nonlocal count
        count += path.name == "last.pt"
        if path.name == "last.pt" and count == call:
            if when == "half_written":
                temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
                temporary.write_bytes(data[: len(data) // 2])
                die()
            kill_at(os, "replace", 1, when="before" if when == "before_rename" else "after")
        write(path, data)

    checkpoint._write_atomically = mortal


def kill_in_log(call):
    """Die with half a line of metrics.jsonl on the disk."""
    add, count = run_log.RunLog.add, 0

    def mortal(self, kind, *args):
        nonlocal count
        count += kind == "train"
        if count == call:
            self._file.write('{"kind": "train", "iter')
            self._file.flush()
            die()
        add(self, kind, *args)

    run_log.RunLog.add = mortal


if __name__ == "__main__":
    run_dir, place, call = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    if place == "env_step":
        kill_at(ToyEnv, "step", call)
    elif place == "adam_step":
        kill_at(torch.optim.Adam, "step", call)
    elif place == "evaluate":
        kill_at(trainer, "evaluate_policy", call, when="after")
    elif place == "log":
        kill_in_log(call)
    else:
        kill_in_last_checkpoint(call, place)
    make_toy_trainer(run_dir).train()
