#!/usr/bin/env bash
# Starts Slurm on this machine alone, for trying `hydra/launcher=slurm`: controller, node and accounting from Debian's packages.
# Run as root on a machine or container without a Slurm of its own; it replaces /etc/slurm/slurm.conf and slurmdbd.conf.
# Needs: apt-get install slurm-wlm slurmdbd munge mariadb-server
set -euo pipefail
[ "$(id -u)" = 0 ] || { echo "slurm_one_node: run as root" >&2; exit 2; }
for program in slurmctld slurmd slurmdbd munged mariadbd; do
    command -v "$program" > /dev/null || {
        echo "slurm_one_node: no $program; apt-get install slurm-wlm slurmdbd munge mariadb-server" >&2
        exit 2
    }
done
pgrep -x slurmctld > /dev/null && { echo "slurm_one_node: Slurm runs here already"; exit 0; }

host=$(hostname -s) cores=$(nproc) memory=$(($(awk '/MemTotal/ {print $2}' /proc/meminfo) / 1024 * 9 / 10))
mkdir -p /run/munge /run/mysqld /var/spool/slurmctld /var/spool/slurmd /var/log/slurm
chown munge:munge /run/munge
chown mysql:mysql /run/mysqld
chown slurm:slurm /var/spool/slurmctld /var/log/slurm

# linuxproc and task/none need no cgroup hierarchy of their own, so that this also runs inside a container.
cat > /etc/slurm/slurm.conf << END
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=slurm
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
AccountingStorageType=accounting_storage/slurmdbd
AccountingStorageHost=127.0.0.1
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerParameters=sched_interval=1,batch_sched_delay=0
MpiDefault=none
ReturnToService=2
StateSaveLocation=/var/spool/slurmctld
SlurmdSpoolDir=/var/spool/slurmd
SlurmctldLogFile=/var/log/slurm/slurmctld.log
SlurmdLogFile=/var/log/slurm/slurmd.log
NodeName=node1 NodeHostname=$host NodeAddr=127.0.0.1 CPUs=$cores RealMemory=$memory State=UNKNOWN
PartitionName=main Nodes=node1 Default=YES MaxTime=INFINITE State=UP
END
# The password guards a database that listens on this machine's socket only.
cat > /etc/slurm/slurmdbd.conf << END
AuthType=auth/munge
DbdHost=localhost
SlurmUser=slurm
StorageType=accounting_storage/mysql
StorageLoc=slurm_acct_db
StorageUser=slurm
StoragePass=slurm
LogFile=/var/log/slurm/slurmdbd.log
END
chown slurm:slurm /etc/slurm/slurmdbd.conf
chmod 600 /etc/slurm/slurmdbd.conf

pgrep -x munged > /dev/null || runuser -u munge -- munged
pgrep -x mariadbd > /dev/null || {
    [ -d /var/lib/mysql/mysql ] || mariadb-install-db --user=mysql > /dev/null
    setsid mariadbd --user=mysql --skip-networking > /var/log/slurm/mariadb.log 2>&1 < /dev/null &
}
until mariadb-admin ping > /dev/null 2>&1; do sleep 0.5; done
mariadb -e "CREATE DATABASE IF NOT EXISTS slurm_acct_db; CREATE USER IF NOT EXISTS slurm@localhost IDENTIFIED BY 'slurm';
GRANT ALL ON slurm_acct_db.* TO slurm@localhost;"
runuser -u slurm -- slurmdbd
until sacctmgr -n list cluster > /dev/null 2>&1; do sleep 0.5; done
sacctmgr -n list cluster format=cluster | grep -qw one || sacctmgr -iQ add cluster one
slurmctld
slurmd
until sinfo -h -o %T 2> /dev/null | grep -qE 'idle|alloc|mixed'; do sleep 0.5; done
sinfo
