"""Running trials and judging them by their logs."""
