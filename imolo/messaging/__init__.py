"""The LCM bus: channels, recording and reading of logs."""
