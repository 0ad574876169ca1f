"""Forwards to `maniskill-grpd sweep`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("sweep")
