"""The command line: each command takes the parsed arguments, calls other packages, and prints the results."""

import signal
import sys

if sys.argv[0].rpartition("/")[2] in ("facts-damping", "-m") and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
    # The command's own module is loaded here: an interruption meanwhile ends it with one line.
    from facts_damping.terminal import end_at_once

    signal.signal(signal.SIGINT, end_at_once)
