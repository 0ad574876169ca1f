"""The options that all tasks take, and what makes a value valid."""
