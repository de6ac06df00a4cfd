"""Fuzzing of the readers: each damaged or malicious file must be read or refused with an error that names it."""
