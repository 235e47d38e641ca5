"""How fast it is: `python -m benchmarks` measures everything that has a target."""
