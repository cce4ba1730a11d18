"""What several studies share: what is driven, flown, integrated and traced."""
