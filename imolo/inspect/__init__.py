"""Looking at what is or was on the bus: tables, plots, comparisons, exports."""
