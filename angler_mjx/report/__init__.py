"""Figures, replays, tables and files of others, made of a results folder."""
