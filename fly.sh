. /root/env.sh; W=$HOME/.cache/whirlstand/target/release/whirlstand; cd /tmp/w/cr; rm -rf out module receiver
$WHIRLSTAND_PYTHON radio.py module receiver report.json "$1" "$2" 2> radio.err & R=$!
while [ ! -e receiver ]; do :; done
timeout -s INT ${3:-40} $W run bridge.toml --out out 2> bench.err >/dev/null
kill $R
grep LATE radio.err; grep -E "mirror|steps/s" bench.err | tail -40
