"""A program that runs out of memory in flight, once.

    hungry.py LIVES PROGRAM [ARGUMENT ...]

runs PROGRAM. In its first life (LIVES does not exist yet) it may have 64 MB more than at the first step that it tells, and takes
16 MB with each that follows: what then gets no memory ends it, as it would end any program.
"""

import os
import resource
import runpy
import sys


class Hungry:
    """Standard output, on which the program tells steps."""

    def __init__(self, out):
        self.out, self.taken = out, None

    def write(self, text):
        if "step" in text and self.taken is None:
            with open("/proc/self/status") as status:
                size = next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmSize:"))
            resource.setrlimit(resource.RLIMIT_AS, (size + (64 << 20), resource.RLIM_INFINITY))
            self.taken = []
        elif "step" in text:
            self.taken.append(bytearray(16 << 20))
        return self.out.write(text)

    def flush(self):
        self.out.flush()


def main():
    lives, program, *arguments = sys.argv[1:]
    if not os.path.exists(lives):
        open(lives, "w").close()
        sys.stdout = Hungry(sys.stdout)
    sys.argv = [program, *arguments]
    sys.path.insert(0, os.path.dirname(program))
    runpy.run_path(program, run_name="__main__")


if __name__ == "__main__":
    main()
