# The guest's second program, which runs once the root is in place: sets up a minimal Linux and runs
# the third program; with BOOTED, a complete Linux whose init is systemd.
. /mnt/exchange/environment  # MODULES, BOOTED
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
export PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1 CAIRN_HARDWARE_GUEST=1
release=$(uname -r)
mkdir -p "/lib/modules/$release" /dev/pts /dev/shm /run
mount --bind "$MODULES" "/lib/modules/$release"  # for the kernel's own calls of modprobe
mount -t tmpfs tmpfs /run
if [ -n "$BOOTED" ]; then
    mkdir -p /run/systemd/system /run/systemd/system-generators
    cp /mnt/exchange/tests.service /run/systemd/system
    for generator in /lib/systemd/system-generators/*; do
        ln -s /dev/null "/run/systemd/system-generators/${generator##*/}"  # the host's disks are not in the guest
    done
    exec /lib/systemd/systemd --unit=tests.service --log-target=journal-or-kmsg --show-status=no
fi
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
/lib/systemd/systemd-udevd --daemon
sh /mnt/exchange/third_program.sh
busybox poweroff -f
