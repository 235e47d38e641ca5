"""The report: one self-contained page of everything in a results folder."""
