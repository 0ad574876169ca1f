"""Forwards to `maniskill-grpd evaluate_study`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("evaluate_study")
