"""Forwards to `maniskill-grpd inspect`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("inspect")
