"""The fit in compiled loops on the CPU, behind the same call as the plain version."""
