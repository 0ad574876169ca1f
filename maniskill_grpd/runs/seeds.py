"""Seeds of episodes, in ranges that do not meet.

Training resets use seeds from 2**30 up, and evaluations during a training those from 500,000.
"""

FIRST_TEST_SEED = 1_000_000
"""Of the first episode on which a trained policy is tested."""

FIRST_VIDEO_SEED = 2_000_000
"""Of the first episode that a video of a training shows."""
