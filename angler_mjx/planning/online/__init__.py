"""Planning while robots fly: order of passing kept by those who are late, and plans made anew."""
