"""What a user types: each command takes the parsed command line, calls other rooms, says what came out."""
