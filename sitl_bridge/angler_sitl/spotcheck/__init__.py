"""Spot checks: episodes of a batch run repeated on real autopilots, and the gaps between both."""
