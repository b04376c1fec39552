"""Long fuzzing: `python -m tools.fuzz`, or `make fuzz`; kills and full disks (`make kills`); a long run (`make long-run`)."""
