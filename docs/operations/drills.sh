#!/usr/bin/env bash
# Failure drills: breaks a real stack of two synthetic cameras in every way of docs/operations/README.md and shows
# what an operator sees. From the project's root, as root (a small disk and a small /dev/shm are mounted, in a mount
# namespace of this script's own):
#   bash docs/operations/drills.sh > drills.txt
# Everything lies in a folder of its own, with a prefix of its own; a stack of yours is not touched.
set -uo pipefail
if [ "${1:-}" != inside ]; then exec unshare --mount bash "$0" inside; fi

root=$PWD
bin=$root/.venv/bin
work=$(mktemp -d /tmp/drills-XXXX)
export TAGMILL_PREFIX=drill TAGMILL_RUN_DIR=$work/run PYTHONPATH=$work/drivers:$root COLUMNS=110
log=$work/run/drill/log
mount -t tmpfs -o size=200m tmpfs /dev/shm
mkdir -p "$work/rig/dataset"
mount -t tmpfs -o size=600m tmpfs "$work/rig/dataset"
cd "$work/rig"
(cd "$root" && "$bin/python" -c "import sys; from pathlib import Path; from tests.support.unpluggable import install; install(Path(sys.argv[1]))" "$work/drivers")

cat > rig.yaml <<'RIG'
dataset: {root: ./dataset, session: drill}
objects:
  - name: box-1
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 150, border_mm: 15}
      left:  {marker: 1, marker_size_mm: 150, border_mm: 15}
      right: {marker: 2, marker_size_mm: 150, border_mm: 15}
      back:  {marker: 3, marker_size_mm: 150, border_mm: 15}
      top:   {marker: 4, marker_size_mm: 150, border_mm: 15}
pose: {ambiguous: keep}
record: {incomplete: keep}
cameras:
  cam0: {driver: synthetic, width: 320, height: 240, fps: 5, prerendered: 4}
  cam1: {driver: unpluggable, width: 320, height: 240, fps: 5, prerendered: 4}
ring: {slots: 6, samples: 16}
RIG

tagmill() { "$bin/tagmill" "$@" --rig rig.yaml 2>&1; }
show() { echo "\$ $*"; "$@" 2>&1 | sed "s#$work#...#g" | cut -c1-200; }
drill() { printf '\n## %s\n\n' "$*"; }
pid_of() { "$bin/supervisorctl" -c "$TAGMILL_RUN_DIR/drill/supervisord.conf" pid "$1"; }
ready() {
  for _ in $(seq 240); do
    tagmill status --json | "$bin/python" -c 'import json,sys; s=json.load(sys.stdin); c=s.get("cameras",{}); sys.exit(bool(s.get("missing",1)) or any(v["phase"]!="running" for v in s["services"].values()) or sum(v["phase"]=="streaming" for v in c.values())<2)' 2>/dev/null && return
    sleep 0.5
  done
  echo "NOT READY"; tagmill status
}
sentences() { tagmill status | grep -E "^(!|ready|not complete|recording rec)" ; }
heads() { tail -n 400 "$log/$1.log" | grep -E "\"event\": \"($2)\"" | tail -n "${3:-3}" | sed -E 's/, "(boot|pid|timestamp)": [^,}]*//g'; }
recording() { show tagmill start --every 2; }
ending() { show tagmill stop; }
now() { echo "\$ tagmill status"; sentences | sed "s#$work#...#g"; }
said() { echo "(in the log of $1)"; heads "$@" | sed "s#$work#...#g" | cut -c1-240; }
clean() { rm -rf dataset/drill/bin; find dataset/drill/rgb dataset/drill/depth dataset/drill/label -type f -delete; }

show tagmill up --detach
ready

for name in capture-cam0 detect label store control; do
  drill "kill -9 $name while it records"
  recording; sleep 3
  echo "\$ kill -9 \$(supervisorctl pid $name)"; kill -9 "$(pid_of $name)"
  sleep 0.5; now; ready; echo "... and a few seconds later"; now
  ending
done

drill "Label stands still for 10 s (kill -STOP, then -CONT)"
recording; sleep 2; pid=$(pid_of label); kill -STOP "$pid"; sleep 10; now; kill -CONT "$pid"; sleep 3; now; ending

drill "The store stands still for a minute"
recording; sleep 2; pid=$(pid_of store); kill -STOP "$pid"; sleep 5
show tagmill record --camera cam0 --timeout 3
sleep 55; now; kill -CONT "$pid"; sleep 4; now; ending

drill "The disk is full"
fallocate -l "$(($(df --output=avail -B1 dataset | tail -1) - 1000000))" dataset/filler
show tagmill record --camera cam0 --count 8; now
rm dataset/filler; show tagmill record --camera cam0

drill "The dataset is read-only"
mount -o remount,ro "$work/rig/dataset"
show tagmill record --camera cam0; now
mount -o remount,rw "$work/rig/dataset"; show tagmill record --camera cam0

drill "The session's folder is deleted"
rm -rf dataset/drill
show tagmill record --camera cam0; now
show tagmill session drill; show tagmill record --camera cam0

drill "A camera is unplugged and comes back"
recording; sleep 2; touch unplugged; sleep 4; now; said capture-cam1 'camera\.[a-z_]+' 3
rm unplugged; ready; now; ending

drill "A thousand clients, and garbage, on the command socket"
"$bin/python" - "$TAGMILL_RUN_DIR/drill/command" <<'PY'
import sys, time, msgpack, zmq
context = zmq.Context(); context.max_sockets = 2000
poller, clients = zmq.Poller(), []
for number in range(1000):
    client = context.socket(zmq.DEALER); client.linger = 0; client.connect(f"ipc://{sys.argv[1]}"); clients.append(client)
    client.send(msgpack.packb({"command": "status"}) if number % 2 else b"\xc1garbage"); poller.register(client, zmq.POLLIN)
answers, deadline = 0, time.monotonic() + 60
while answers < 1000 and time.monotonic() < deadline:
    for client, _ in poller.poll(1000): client.recv(); poller.unregister(client); answers += 1
print(f"1,000 clients, half of them garbage: {answers} answers")
context.destroy(linger=0)
PY
now; show tagmill record --camera cam0

drill "A subscriber that never reads"
"$bin/python" - "$TAGMILL_RUN_DIR/drill/subscribe" <<'PY' &
import sys, time, zmq
reader = zmq.Context().socket(zmq.SUB); reader.rcvhwm = 1; reader.connect(f"ipc://{sys.argv[1]}"); reader.subscribe(b""); time.sleep(15)
PY
sleep 8; show tagmill record --camera all; now; wait %1

drill "Ten pages of the console"
url=$(tagmill status --json | "$bin/python" -c 'import json,sys; print(json.load(sys.stdin)["services"]["console"]["texts"]["url"])')
"$bin/python" - "$url" <<'PY'
import sys, time
from common.bus import Poller
from tools.bench.console_pages import Pages
with Pages(sys.argv[1], "cam0", 10, 320) as pages:
    Poller().wait(8)
print("pictures shown by each of ten pages in 8 s:", pages.result().pictures)
PY
now; show tagmill record --camera cam0

drill "/dev/shm is full when a camera starts"
kill -9 "$(pid_of capture-cam0)"; fallocate -l "$(df --output=avail -B1 /dev/shm | tail -1)" /dev/shm/filler
sleep 8; now
rm /dev/shm/filler; ready; now

drill "supervisord is killed"
recording; sleep 2; pid=$("$bin/supervisorctl" -c "$TAGMILL_RUN_DIR/drill/supervisord.conf" pid); echo "\$ kill -9 $pid"; kill -9 "$pid"
show tagmill down; show tagmill up --detach; ready; now
echo '$ tagmill ledger <that recording>'; recording_id=$(ls -t "$log" >/dev/null; "$bin/python" -c 'import json; s=json.load(open("dataset/drill/session.json")); r=sorted(s["recordings"])[-1]; l=s["recordings"][r]; print(r, l["phase"], {c: (a["captured"], a["recorded"], a["refused"], a["dropped"]) for c, a in l["cameras"].items()})'); echo "$recording_id"


drill "The clock is set back by an hour, and the disk takes 400 ms a sample"
show tagmill down
export TAGMILL_WALL_OFFSET_S=-3600 TAGMILL_STORE_DELAY_MS=400
show tagmill up --detach; ready; recording; sleep 8; now; ending
show tagmill record --camera cam0
unset TAGMILL_WALL_OFFSET_S TAGMILL_STORE_DELAY_MS

drill "After all of it"
show tagmill inspect drill --verify
show tagmill down
echo '$ ls run folder and /dev/shm'; ls "$TAGMILL_RUN_DIR/drill" /dev/shm | grep -v -E "log|conf" ; ps -eo args | grep -c "[s]ervices\..*$work"
cd /; umount -l "$work/rig/dataset"; rm -rf "$work"
