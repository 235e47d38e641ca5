"""Fit what is assumed to what was measured, the same for every engine, and judge it on recordings held out."""
