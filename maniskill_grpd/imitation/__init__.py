"""Learning from experts: demonstrations, cloning, and the same scenes turned."""
