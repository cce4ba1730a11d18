"""Sea trials of a vehicle in still water: speeds, turning, zig-zag, spiral, stopping, decay."""
