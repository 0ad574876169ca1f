"""Forwards to `maniskill-grpd video`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("video")
