"""What a user types: each command takes the parsed command line, calls other rooms, says what came out."""

import signal
import sys

if sys.argv[0].rpartition("/")[2] in ("facts-damping", "-m") and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
    # It is the command that is loaded: an interruption meanwhile ends it with a line.
    from facts_damping.terminal import end_at_once

    signal.signal(signal.SIGINT, end_at_once)
