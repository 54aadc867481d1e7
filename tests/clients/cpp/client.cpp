// A client written from firmware_proto/SPEC.md alone: the four streams of what was measured, and their frames.
//
//     client PUBLISH CONTROL FRAMES
//
// subscribes, prints one line of plain words and numbers for each message it understood, and ends after FRAMES frames.
// What a message must be is checked here; what must be in it is for the reader of the lines. Exit status 1: a message
// was not what SPEC.md says, and the last line on stderr says which.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <msgpack.hpp>
#include <zmq.hpp>

namespace {

using Fields = std::map<std::string, msgpack::object>;

[[noreturn]] void wrong(const std::string &what) { throw std::runtime_error(what); }

void must(bool holds, const char *what) {
    if (!holds) wrong(what);
}

Fields fields_of(const msgpack::object &object) { return object.as<Fields>(); }

const msgpack::object &at(const Fields &fields, const char *key) {
    const auto found = fields.find(key);
    if (found == fields.end()) wrong(std::string("no key ") + key);
    return found->second;
}

std::uint64_t count(const Fields &fields, const char *key) { return at(fields, key).as<std::uint64_t>(); }
std::string text(const Fields &fields, const char *key) { return at(fields, key).as<std::string>(); }
bool nil(const Fields &fields, const char *key) { return at(fields, key).is_nil(); }

// A count, or -1 for nil.
long long count_or(const Fields &fields, const char *key) {
    return nil(fields, key) ? -1 : static_cast<long long>(count(fields, key));
}

std::string bytes(const Fields &fields, const char *key) {
    const msgpack::object &object = at(fields, key);
    if (object.type != msgpack::type::BIN) wrong(std::string("no bin: ") + key);
    return {object.via.bin.ptr, object.via.bin.size};
}

// Little-endian numbers; this machine's order does not matter.
std::uint64_t little(const std::string &data, std::size_t from, std::size_t size) {
    must(from + size <= data.size(), "a field lies beyond the end");
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < size; ++i)
        value |= static_cast<std::uint64_t>(static_cast<unsigned char>(data[from + i])) << (8 * i);
    return value;
}

float f32(const std::string &data, std::size_t from) {
    const auto bits = static_cast<std::uint32_t>(little(data, from, 4));
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

double f64(const std::string &data, std::size_t from) {
    const std::uint64_t bits = little(data, from, 8);
    double value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

// FNV-1a of 64 bits, so that a line stands for all bytes.
unsigned long long hash(const std::string &data) {
    std::uint64_t value = 0xcbf29ce484222325u;
    for (const char byte : data) value = (value ^ static_cast<unsigned char>(byte)) * 0x100000001b3u;
    return value;
}

void all_finite_f32(const std::string &data) {
    for (std::size_t i = 0; i < data.size(); i += 4) must(std::isfinite(f32(data, i)), "a number is not finite");
}

void all_finite_f64(const std::string &data) {
    for (std::size_t i = 0; i < data.size(); i += 8) must(std::isfinite(f64(data, i)), "a number is not finite");
}

// Section 7, The published frame; eitskin.hpp reads the rest of it.
void frame(const Fields &fields) {
    std::printf("frame %llu\n", static_cast<unsigned long long>(count(fields, "n")));
}

double volts_per_count = 0.0;  // of HELLO, once a state has come

// Streams: wire; the payload is section 4.
void wire(std::uint64_t number, const Fields &fields) {
    const std::string payload = bytes(fields, "payload");
    double sum = 0.0;
    unsigned long long sequence = 0;
    if (!nil(fields, "seq")) {
        must(little(payload, 0, 1) == 0x82, "type of a FRAME");
        const std::size_t width = little(payload, 2, 1), rows = little(payload, 3, 1);
        must(width >= 2 && width <= 4 && payload.size() == 20 + rows * width + (rows + 7) / 8, "length of a FRAME");
        sequence = little(payload, 8, 4);
        must(sequence == (count(fields, "seq") & 0xffffffffu), "seq is not the unwrapped sequence");
        must((count(fields, "device_us") & 0xffffffffu) == little(payload, 12, 4), "device_us");
        for (std::size_t row = 0; row < rows; ++row) {
            const std::uint64_t raw = little(payload, 20 + row * width, width);
            const std::uint64_t sign = std::uint64_t{1} << (8 * width - 1);
            const auto sample = static_cast<std::int64_t>(raw ^ sign) - static_cast<std::int64_t>(sign);
            sum += std::fabs(static_cast<double>(sample));
        }
    }
    const std::string withheld = text(fields, "withheld");
    std::printf("wire %llu seq %lld read %llu frame %lld map_seq %lld solver %s touched %d gate_logit %.17g "
                "withheld %s conditions %llu hash %llx volts %.15g\n",
                static_cast<unsigned long long>(number), count_or(fields, "seq"),
                static_cast<unsigned long long>(count(fields, "read_ns")), count_or(fields, "frame"),
                count_or(fields, "map_seq"), text(fields, "solver").c_str(), at(fields, "touched").as<bool>(),
                at(fields, "gate_logit").as<double>(), withheld.empty() ? "-" : withheld.c_str(),
                static_cast<unsigned long long>(count(fields, "conditions")), hash(payload), sum * volts_per_count);
}

void cloud(std::uint64_t number, const Fields &fields) {
    const auto shape = at(fields, "shape").as<std::vector<std::uint64_t>>();
    const std::string points = bytes(fields, "cloud");
    must(shape.size() == 2 && points.size() == 12 * shape[0] * shape[1], "size of the cloud");
    all_finite_f32(points);
    const std::string logs = bytes(fields, "log_predicted");
    must(logs.size() == 416, "log_predicted");
    all_finite_f32(logs);
    unsigned long long predicted[2] = {0, 0};
    const char *names[2] = {"predicted", "predicted_flat"};
    for (int i = 0; i < 2; ++i)
        if (!nil(fields, names[i])) {
            const std::string volts = bytes(fields, names[i]);
            must(volts.size() == 832, names[i]);
            all_finite_f64(volts);
            predicted[i] = hash(volts);
        }
    std::printf("cloud %llu revision %llu seq %lld why %s taken %llu utc %llu hash %llx predicted %llx "
                "predicted_flat %llx log_predicted %llx corner %.9g %.9g %.9g\n",
                static_cast<unsigned long long>(number), static_cast<unsigned long long>(count(fields, "revision")),
                count_or(fields, "seq"), text(fields, "why").c_str(),
                static_cast<unsigned long long>(count(fields, "taken_ns")),
                static_cast<unsigned long long>(count(fields, "utc_ns")), hash(points), predicted[0], predicted[1],
                hash(logs), f32(points, 0), f32(points, 4 * shape[0] * shape[1]), f32(points, 8 * shape[0] * shape[1]));
}

void conditions(std::uint64_t number, const Fields &fields) {
    unsigned long long drift = 0;
    if (!nil(fields, "drift")) {
        const std::string factors = bytes(fields, "drift");
        must(factors.size() == 416, "drift");
        all_finite_f32(factors);
        drift = hash(factors);
    }
    const auto regions = at(fields, "regions").as<std::vector<std::vector<std::uint64_t>>>();
    must(!regions.empty() && regions.size() <= 16, "regions");
    for (const auto &region : regions)
        must(region.size() == 4 && region[0] < region[1] && region[2] < region[3], "region");
    must(text(fields, "reference").size() == 64, "reference");
    std::printf("conditions %llu revision %llu seq %llu cloud %llu reference %s threshold %.17g drift %llx regions %zu "
                "electrodes %zu missing %zu skip %d volts_per_count %.17g\n",
                static_cast<unsigned long long>(number), static_cast<unsigned long long>(count(fields, "revision")),
                static_cast<unsigned long long>(count(fields, "seq")),
                static_cast<unsigned long long>(count(fields, "cloud")), text(fields, "reference").c_str(),
                nil(fields, "gate_threshold") ? NAN : at(fields, "gate_threshold").as<double>(), drift, regions.size(),
                at(fields, "electrodes").as<std::vector<msgpack::object>>().size(),
                at(fields, "missing_rows").as<std::vector<std::uint64_t>>().size(),
                at(fields, "skip_unchanged").as<bool>(), at(fields, "volts_per_count").as<double>());
}

void state(std::uint64_t number, const Fields &fields) {
    const std::string hello = bytes(fields, "hello");  // section 5
    must(hello.size() >= 100 && little(hello, 0, 1) == 0x80 && hello.substr(2, 4) == "EITS", "HELLO");
    const std::string serial(hello.substr(32, 16).c_str());
    must(serial == text(fields, "serial"), "serial number of HELLO");
    volts_per_count = f64(hello, 92);
    const Fields status = fields_of(at(fields, "status"));
    const std::string reference = nil(fields, "reference") ? "" : bytes(fields, "reference");
    std::printf("state %llu serial %s configuration %s bundle %s skin %s host %s solvers %s reference %s file %llx "
                "rate_mHz %llu lost %llu frames %llu made %llu utc %llu events %zu\n",
                static_cast<unsigned long long>(number), serial.c_str(), text(fields, "configuration").c_str(),
                text(fields, "bundle").c_str(), text(fields, "skin").c_str(), text(fields, "host").c_str(),
                at(fields, "solvers").as<std::vector<std::string>>().at(0).c_str(),
                text(fields, "reference_sha256").c_str(), reference.empty() ? 0 : hash(reference),
                static_cast<unsigned long long>(little(hello, 72, 4)),
                static_cast<unsigned long long>(count(status, "lost")),
                static_cast<unsigned long long>(count(status, "frames")),
                static_cast<unsigned long long>(count(fields, "made_ns")),
                static_cast<unsigned long long>(count(fields, "utc_ns")),
                at(fields, "events").as<std::vector<msgpack::object>>().size());
}

// Streams: six keys, the stream's name first; bodies in parts.
void stream(const msgpack::object &message) {
    must(message.via.map.size == 6, "six keys");
    const std::string name = message.via.map.ptr[0].key.as<std::string>();
    const Fields fields = fields_of(message);
    must(count(fields, "v") == 3, "version of a stream");
    static std::map<std::string, std::string> joined;
    const std::uint64_t number = count(fields, name.c_str());
    const std::uint64_t part = count(fields, "part"), parts = count(fields, "parts");
    must(parts >= 1 && parts <= 32 && part < parts, "parts");
    if (part == 0) joined[name].clear();
    joined[name] += bytes(fields, "body");
    if (part + 1 < parts) return;
    const msgpack::object_handle body = msgpack::unpack(joined[name].data(), joined[name].size());
    const Fields inner = fields_of(body.get());
    if (name == "wire") wire(number, inner);
    else if (name == "cloud") cloud(number, inner);
    else if (name == "conditions") conditions(number, inner);
    else if (name == "state") state(number, inner);
    else wrong("a stream that SPEC.md does not name: " + name);
}

// Section 8.
void ask_status(zmq::context_t &context, const char *endpoint) {
    zmq::socket_t socket(context, zmq::socket_type::req);
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::rcvtimeo, 60000);
    socket.connect(endpoint);
    msgpack::sbuffer request;
    msgpack::pack(request, std::map<std::string, std::string>{{"command", "status"}});
    socket.send(zmq::buffer(request.data(), request.size()), zmq::send_flags::none);
    zmq::message_t answer;
    if (!socket.recv(answer)) wrong("no answer to status");
    const msgpack::object_handle handle = msgpack::unpack(static_cast<const char *>(answer.data()), answer.size());
    const Fields fields = fields_of(handle.get());
    must(at(fields, "ok").as<bool>(), "status is refused");
    std::printf("status serial %s bundle %s configuration %s cloud %llu\n", text(fields, "serial_number").c_str(),
                text(fields, "bundle").c_str(), text(fields, "configuration").c_str(),
                static_cast<unsigned long long>(count(fields, "cloud")));
}

void follow(const char *publish, const char *control, unsigned long long wanted) {
    zmq::context_t context(1);
    zmq::socket_t socket(context, zmq::socket_type::sub);
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::rcvtimeo, 60000);
    for (const char *topic : {"eitskin/region/whole", "eitskin/always", "eitskin/touches", "\xde", "\x86"})
        socket.set(zmq::sockopt::subscribe, topic);
    socket.connect(publish);
    ask_status(context, control);
    for (unsigned long long frames = 0; frames < wanted;) {
        zmq::message_t message;
        if (!socket.recv(message)) wrong("nothing came for a minute");
        must(!message.more() && message.size() <= 68608, "one part of at most 68608 bytes");
        const msgpack::object_handle handle =
            msgpack::unpack(static_cast<const char *>(message.data()), message.size());
        must(handle->type == msgpack::type::MAP, "a map");
        const auto first = *static_cast<const unsigned char *>(message.data());
        if (first == 0x86) {
            stream(handle.get());
        } else {
            const Fields fields = fields_of(handle.get());
            must(count(fields, "v") == 1, "version of a frame");
            frame(fields);
            ++frames;
        }
        std::fflush(stdout);
    }
}

}  // namespace

int main(int argc, char **argv) {
    if (argc != 4) {
        std::fprintf(stderr, "usage: client PUBLISH CONTROL FRAMES\n");
        return 2;
    }
    try {
        follow(argv[1], argv[2], std::strtoull(argv[3], nullptr, 10));
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
    return 0;
}
