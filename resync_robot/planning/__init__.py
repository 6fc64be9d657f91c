"""Symbols from states, and plans from symbols."""
