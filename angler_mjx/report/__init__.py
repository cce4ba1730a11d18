"""Figures, replays, tables and exchange files of a results folder."""
