#!/usr/bin/env python3
"""Leads hands of Osteotome over UDP (docs/remote-hand.md). Needs Python 3.8 and nothing else.

    osteotome run scenarios/bsso_right.toml --mode realtime --out out \\
        --set 'tool.0.device="remote:9870"' --set 'tool.1.device="remote:9871"'

    python3 examples/remote_hand.py --hand 9870 --hand 9871
        each hand on a small circle: prints what it feels
    python3 examples/remote_hand.py --hand 9870:left.csv --hand 9871:right.csv
        each hand along a file's poses, a line a millisecond: x y z qx qy qz qw (mm; start at 0 0 0 0 0 0 1)

To attach a device of your own, replace `Hand.pose` by a reading of it, and give `Hand.force` to it.
"""

import argparse
import math
import random
import socket
import struct
import sys
import time

HEADER = struct.Struct("<4sHHIIQ")  # magic, version, kind, session, sequence, client's time [us]
POSE = struct.Struct("<13dII")  # position, orientation x y z w, velocity, angular velocity, buttons, 0
WRENCH = struct.Struct("<Q6dII")  # simulator's time [us], force [N], torque [N mm], fault, 0
MAGIC, VERSION, POSE_KIND, WRENCH_KIND = b"OSTH", 1, 1, 2


class Hand:
    """One hand: a socket, a path through space, and what was felt last."""

    def __init__(self, address, path):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(address)
        self.path = path
        self.session = random.getrandbits(32)
        self.sequence = 0
        self.force = (0.0, 0.0, 0.0)
        self.peak = 0.0
        self.answers = 0
        self.fault = 0
        self.round_trips = []

    def pose(self, t):
        """Position [mm] and orientation (x, y, z, w) at time t [s] of the play."""
        if self.path:
            return self.path[min(int(t * 1e3), len(self.path) - 1)]
        turn = 2.0 * math.pi * 0.5 * t
        return (5.0 * math.sin(turn), 0.0, 5.0 * (math.cos(turn) - 1.0), 0.0, 0.0, 0.0, 1.0)

    def send(self, t):
        now, before = self.pose(t), self.pose(max(t - 0.002, 0.0))
        dt = min(t, 0.002)
        velocity = [(a - b) / dt if dt > 0.0 else 0.0 for a, b in zip(now[:3], before[:3])]
        self.sequence = (self.sequence + 1) & 0xFFFFFFFF
        header = HEADER.pack(MAGIC, VERSION, POSE_KIND, self.session, self.sequence, clock_us())
        try:
            self.socket.send(header + POSE.pack(*now, *velocity, 0.0, 0.0, 0.0, 0, 0))
        except OSError:
            pass  # nobody listens yet, or the buffer is full: the next packet may do

    def receive(self):
        for _ in range(64):
            try:
                packet = self.socket.recv(2048)
            except OSError:
                return
            if len(packet) != HEADER.size + WRENCH.size:
                continue
            magic, version, kind, session, _, sent = HEADER.unpack_from(packet)
            if (magic, version, kind, session) != (MAGIC, VERSION, WRENCH_KIND, self.session):
                continue
            _, fx, fy, fz, _, _, _, self.fault, _ = WRENCH.unpack_from(packet, HEADER.size)
            self.force = (fx, fy, fz)
            self.peak = max(self.peak, math.hypot(fx, fy, fz))
            self.answers += 1
            if sent:
                self.round_trips.append(clock_us() - sent)


def clock_us():
    return time.monotonic_ns() // 1000


def read_path(name):
    with open(name, encoding="ascii") as file:
        path = [tuple(float(word) for word in line.split()) for line in file if line.strip()]
    if not path or any(len(pose) != 7 for pose in path):
        sys.exit(f"{name}: give lines of seven numbers: x y z qx qy qz qw")
    return path


def quantile(values, share):
    return sorted(values)[int(share * (len(values) - 1))] if values else 0


def main():
    parser = argparse.ArgumentParser(description="Leads hands of Osteotome over UDP.")
    parser.add_argument("--hand", action="append", metavar="PORT[:FILE]", required=True)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--seconds", type=float, help="how long; default: to the end of the files, else 10")
    parser.add_argument("--wait", type=float, default=600.0, help="how long to wait for the session")
    arguments = parser.parse_args()
    hands = []
    for hand in arguments.hand:
        port, _, name = hand.partition(":")
        hands.append(Hand((arguments.host, int(port)), read_path(name) if name else None))
    longest = max((len(h.path) for h in hands if h.path), default=10_000) / 1e3
    seconds = arguments.seconds or longest

    # At the start of the path until the session answers every hand; then along it. While the session is paused, and over
    # hiccups of this program, the hands wait: what they missed meanwhile would shift them against the bone.
    before = waiting = time.monotonic()
    has_begun = False
    t = told = 0.0
    while t < seconds:
        now = time.monotonic()
        has_begun = has_begun or all(h.answers for h in hands)
        if has_begun and not any(h.fault for h in hands):
            t += min(now - before, 0.005)
        if not has_begun and now - waiting > arguments.wait:
            sys.exit("nobody has answered; is the session running, with these ports?")
        before = now
        for hand in hands:
            hand.send(t)
            hand.receive()
        if t - told > 1.0:
            told = t
            felt = ", ".join("(%.2f %.2f %.2f) N" % h.force for h in hands)
            print(f"{t:5.1f} s  {felt}", flush=True)
        time.sleep(0.0008)
    for number, hand in enumerate(hands):
        trip = [quantile(hand.round_trips, share) for share in (0.5, 0.99)]
        print(f"hand {number}: {hand.sequence} poses, {hand.answers} answers, at most {hand.peak:.2f} N, "
              f"pose to wrench {trip[0]} us ({trip[1]} us at 99 %)")


if __name__ == "__main__":
    main()
