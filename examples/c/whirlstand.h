/* The messages of a Whirlstand bench for C, as docs/wire-format.md lays them out. Needs nothing but a C99 compiler.
 *
 * A message is a structure of fixed size. A datagram holds the schema hash (8 bytes, little-endian) and then postcard:
 * every double as 8 bytes little-endian, every uint64_t and uint32_t as a LEB128 varint, every uint8_t as it is. */

#ifndef WHIRLSTAND_H
#define WHIRLSTAND_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Fields of one type that stand together: 'd' double, 'q' uint64_t, 'i' uint32_t, 'b' uint8_t. */
typedef struct {
    char type;
    uint16_t count;
} whirlstand_fields;

/* How a message is laid out; the fields end with a count of 0. */
typedef struct {
    uint64_t hash;
    size_t size;
    whirlstand_fields fields[16];
} whirlstand_layout;

typedef struct {
    uint64_t seq;      /* counts the messages of one publisher */
    uint64_t step;     /* step of the loop */
    uint64_t stamp_ns; /* bench time of that step */
} whirlstand_head;

/* layouts: begin */

/* topic imu, 80 bytes */
typedef struct {
    whirlstand_head head;
    double roll;
    double pitch;
    double yaw;
    double roll_rate;
    double pitch_rate;
    double yaw_rate;
    uint32_t valid;
    uint32_t flags;
} whirlstand_imu;
static const whirlstand_layout whirlstand_imu_layout = {0xbcae7513cba6275bu, sizeof(whirlstand_imu), {{'q', 3}, {'d', 6}, {'i', 2}}};

/* topic odometry, 80 bytes */
typedef struct {
    whirlstand_head head;
    double longitudinal_position;
    double lateral_position;
    double height;
    double longitudinal_speed;
    double lateral_speed;
    double vertical_speed;
    uint32_t valid;
    uint32_t reserved;
} whirlstand_odometry;
static const whirlstand_layout whirlstand_odometry_layout = {0xb576362c2fa31ae2u, sizeof(whirlstand_odometry), {{'q', 3}, {'d', 6}, {'i', 2}}};

/* topic outputs, 288 bytes */
typedef struct {
    whirlstand_head head;
    double y[32];
    uint64_t valid;
} whirlstand_outputs;
static const whirlstand_layout whirlstand_outputs_layout = {0xdcd91c371c55a956u, sizeof(whirlstand_outputs), {{'q', 3}, {'d', 32}, {'q', 1}}};

/* topic estimate, 336 bytes */
typedef struct {
    whirlstand_head head;
    double x[16];
    double std[16];
    double bias[4];
    double nis;
    uint32_t dof;
    uint32_t count;
    uint32_t flags;
    uint32_t reserved;
} whirlstand_estimate;
static const whirlstand_layout whirlstand_estimate_layout = {0xeb99a7d75a3eeacdu, sizeof(whirlstand_estimate), {{'q', 3}, {'d', 37}, {'i', 4}}};

/* topic command, 96 bytes */
typedef struct {
    whirlstand_head head;
    double u[8];
    uint32_t count;
    uint32_t flags;
} whirlstand_command;
static const whirlstand_layout whirlstand_command_layout = {0xb7d9d211592d206eu, sizeof(whirlstand_command), {{'q', 3}, {'d', 8}, {'i', 2}}};

/* topic setpoint, 224 bytes */
typedef struct {
    whirlstand_head head;
    double x[16];
    double stick[8];
    uint64_t tracked;
} whirlstand_setpoint;
static const whirlstand_layout whirlstand_setpoint_layout = {0x8d789c7eb22297dfu, sizeof(whirlstand_setpoint), {{'q', 3}, {'d', 24}, {'q', 1}}};

/* topic truth, 232 bytes */
typedef struct {
    whirlstand_head head;
    double x[16];
    double u[8];
    uint32_t states;
    uint32_t inputs;
    uint32_t flags;
    uint32_t reserved;
} whirlstand_truth;
static const whirlstand_layout whirlstand_truth_layout = {0x75548f0862fa95edu, sizeof(whirlstand_truth), {{'q', 3}, {'d', 24}, {'i', 4}}};

/* topic disturbance, 160 bytes */
typedef struct {
    whirlstand_head head;
    double dx[16];
    uint32_t count;
    uint32_t reserved;
} whirlstand_disturbance;
static const whirlstand_layout whirlstand_disturbance_layout = {0x795e3c63fe1f170eu, sizeof(whirlstand_disturbance), {{'q', 3}, {'d', 16}, {'i', 2}}};

/* topic sent, 376 bytes */
typedef struct {
    whirlstand_head head;
    double channels[16];
    double u[8];
    double stick[16];
    double link_quality;
    uint64_t messages;
    uint32_t count;
    uint32_t in_charge;
    uint32_t armed;
    uint32_t reason;
} whirlstand_sent;
static const whirlstand_layout whirlstand_sent_layout = {0x626298cbd73834b9u, sizeof(whirlstand_sent), {{'q', 3}, {'d', 41}, {'q', 1}, {'i', 4}}};

/* topic reported, 64 bytes */
typedef struct {
    whirlstand_head head;
    double rssi;
    double remote_rssi;
    double pilot_rssi;
    uint32_t custom_mode;
    uint32_t base_mode;
    uint32_t system_status;
    uint32_t known;
} whirlstand_reported;
static const whirlstand_layout whirlstand_reported_layout = {0xb397116d9a304fa5u, sizeof(whirlstand_reported), {{'q', 3}, {'d', 3}, {'i', 4}}};

/* topic autopilot, 544 bytes */
typedef struct {
    whirlstand_head head;
    double outputs[32];
    double rc[16];
    double gyro[3];
    double accel[3];
    double mag[3];
    double pressure;
    double fix[3];
    double velocity[3];
    uint32_t armed;
    uint32_t fault;
} whirlstand_autopilot;
static const whirlstand_layout whirlstand_autopilot_layout = {0xa50d53367fca3891u, sizeof(whirlstand_autopilot), {{'q', 3}, {'d', 64}, {'i', 2}}};

/* topic health, 232 bytes */
typedef struct {
    whirlstand_head head;
    uint64_t steps;
    uint64_t deadline_misses;
    uint64_t lost;
    uint64_t rejected;
    uint64_t latency_max_ns;
    uint32_t latency[32];
    uint32_t pid;
    uint32_t state;
    uint8_t node[32];
} whirlstand_health;
static const whirlstand_layout whirlstand_health_layout = {0xd46af5720c7cbba0u, sizeof(whirlstand_health), {{'q', 8}, {'i', 34}, {'b', 32}}};

/* topic progress, 40 bytes */
typedef struct {
    whirlstand_head head;
    uint64_t written;
    uint64_t lost;
} whirlstand_progress;
static const whirlstand_layout whirlstand_progress_layout = {0x4a1f30e6492ffa7au, sizeof(whirlstand_progress), {{'q', 5}}};

/* topic adjusted, 64 bytes */
typedef struct {
    whirlstand_head head;
    uint64_t id;
    double value;
    uint64_t length_ns;
    uint32_t what;
    uint32_t index;
    uint32_t verdict;
    uint32_t reserved;
} whirlstand_adjustment;
static const whirlstand_layout whirlstand_adjustment_layout = {0x9566d54f41f05de6u, sizeof(whirlstand_adjustment), {{'q', 4}, {'d', 1}, {'q', 1}, {'i', 4}}};

/* topic stick, 96 bytes */
typedef struct {
    whirlstand_head head;
    double u[8];
    uint64_t id;
} whirlstand_stick;
static const whirlstand_layout whirlstand_stick_layout = {0x48ca180d9c1edd72u, sizeof(whirlstand_stick), {{'q', 3}, {'d', 8}, {'q', 1}}};

/* topic finding, 392 bytes */
typedef struct {
    whirlstand_head head;
    uint64_t number;
    uint64_t since_ns;
    double evidence;
    double probability;
    double value[4];
    double low[4];
    double high[4];
    uint32_t stage;
    uint32_t output;
    uint32_t count;
    uint32_t alike;
    uint8_t effect[32];
    uint8_t place[32];
    uint8_t onto[32];
    uint8_t names[32];
    uint8_t units[32];
    uint8_t alike_effect[32];
    uint8_t alike_place[32];
} whirlstand_finding;
static const whirlstand_layout whirlstand_finding_layout = {0x7717eeb667ca1b99u, sizeof(whirlstand_finding), {{'q', 5}, {'d', 14}, {'i', 4}, {'b', 224}}};

/* layouts: end */

/* Bytes that hold any message on a network. */
enum { WHIRLSTAND_MAX_BYTES = 1024 };

/* Writes a message into `bytes`; returns how many were used, or 0 where `room` is too small. */
static inline size_t whirlstand_encode(const whirlstand_layout *layout, const void *message, uint8_t *bytes, size_t room) {
    const uint8_t *from = (const uint8_t *)message;
    size_t at = 0;
    if (room < 8) return 0;
    for (int k = 0; k < 8; k++) bytes[at++] = (uint8_t)(layout->hash >> (8 * k));
    for (const whirlstand_fields *f = layout->fields; f->count; f++) {
        for (int n = 0; n < f->count; n++) {
            uint64_t value = 0;
            uint32_t narrow;
            if (room - at < 10) return 0;
            switch (f->type) {
            case 'b': bytes[at++] = *from++; continue;
            case 'i': memcpy(&narrow, from, 4), value = narrow, from += 4; break;
            default: memcpy(&value, from, 8), from += 8; break;
            }
            if (f->type == 'd') {
                for (int k = 0; k < 8; k++) bytes[at++] = (uint8_t)(value >> (8 * k));
            } else {
                for (; value >= 0x80; value >>= 7) bytes[at++] = (uint8_t)(value | 0x80);
                bytes[at++] = (uint8_t)value;
            }
        }
    }
    return at;
}

/* Reads a message from `bytes`; returns 1, or 0 where they are not exactly one of this layout (and leaves what is in
 * `message` undefined). */
static inline int whirlstand_decode(const whirlstand_layout *layout, void *message, const uint8_t *bytes, size_t count) {
    uint8_t *to = (uint8_t *)message;
    size_t at = 0;
    uint64_t hash = 0;
    if (count < 8) return 0;
    for (int k = 0; k < 8; k++) hash |= (uint64_t)bytes[at++] << (8 * k);
    if (hash != layout->hash) return 0;
    for (const whirlstand_fields *f = layout->fields; f->count; f++) {
        for (int n = 0; n < f->count; n++) {
            uint64_t value = 0;
            uint32_t narrow;
            if (f->type == 'b') {
                if (at >= count) return 0;
                *to++ = bytes[at++];
                continue;
            }
            if (f->type == 'd') {
                if (count - at < 8) return 0;
                for (int k = 0; k < 8; k++) value |= (uint64_t)bytes[at++] << (8 * k);
            } else {
                for (int shift = 0;; shift += 7) {
                    if (at >= count || shift > 63 || (shift == 63 && bytes[at] > 1)) return 0;
                    value |= (uint64_t)(bytes[at] & 0x7f) << shift;
                    if (!(bytes[at++] & 0x80)) break;
                }
            }
            if (f->type == 'i') {
                if (value > UINT32_MAX) return 0;
                narrow = (uint32_t)value;
                memcpy(to, &narrow, 4), to += 4;
            } else {
                memcpy(to, &value, 8), to += 8;
            }
        }
    }
    return at == count;
}

#endif
