"""What the control room claims, measured: the published experiments side by side, accuracy, tuning, speed, parity."""
