"""Scenes that no domain is made of: for calibration, for judging perception, for films."""
