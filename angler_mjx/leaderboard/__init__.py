"""ANGLER-1: frozen planning problems, submissions, and the board of their scores."""
