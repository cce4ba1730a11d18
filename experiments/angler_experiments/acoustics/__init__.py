"""What talking by sound costs: how far packets get, and how old what is known becomes."""
