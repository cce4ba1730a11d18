"""Control laws: pure functions of one robot that turn a command into the next one down."""
