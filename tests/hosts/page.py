#!/usr/bin/env python3
"""A viewer of the live page, on the host on which this runs.

    page.py URL see TEXT       prints the first frame that has the text
    page.py URL ask CONTROL    asks for a change as the page does, and prints the answer
"""

import sys
import urllib.error
import urllib.request


def main(url, what, text):
    if what == "see":
        for line in urllib.request.urlopen(url + "events"):
            if text in line.decode():
                print(line.decode())
                return
        sys.exit(f"the frames ended without {text}")
    request = urllib.request.Request(url + "control", text.encode(), {"Content-Type": "application/json"})
    try:
        print(urllib.request.urlopen(request).read().decode())
    except urllib.error.HTTPError as error:
        sys.exit(error.read().decode())


if __name__ == "__main__":
    main(*sys.argv[1:])
